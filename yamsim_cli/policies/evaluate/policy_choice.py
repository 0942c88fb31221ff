"""Choice of a policy to evaluate, and settings for its answers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from yamsim_cli.core.episode.episode_rules import EndRule

from ..action_chunks import ChunkSettings
from ..policy_loading import is_external, takes_keywords


@dataclass(frozen=True)
class PolicyChoice:
    """A policy with settings for its answers and its time limits.

    Attributes:
        name, folder: name of the policy, and folder of the user's files, see `make_policy`.
        call_seconds: real-time limit for one answer or reset, s.
        time_limit: simulated-time limit for a trial, s; None for the task's limit.
        end: rule that ends a trial.
        arguments: keywords for a class of the user.
        mapping: name or file of a config of `policies`, for policies of other programs; None for the default.
        chunking: settings for action chunks.
        known_only: whether a class gets only the `arguments` that it accepts.
    """

    name: str
    folder: Path
    call_seconds: float = 30.0
    time_limit: float | None = None
    end: EndRule = EndRule.SUCCESS
    arguments: Mapping[str, int | float | str] = field(default_factory=dict)
    mapping: str | None = None
    chunking: ChunkSettings = field(default_factory=ChunkSettings)
    known_only: bool = False

    def compared_with(self, name: str) -> PolicyChoice:
        """Return the choice of another policy by name, under the same conditions.

        A class of the user gets the keywords that it accepts. A policy of another program gets the same config.
        """
        return replace(
            self,
            name=name,
            arguments=self.arguments if takes_keywords(name) else {},
            mapping=self.mapping if is_external(name) else None,
            known_only=True,
        )
