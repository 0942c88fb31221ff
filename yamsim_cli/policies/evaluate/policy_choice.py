"""The choice of a policy to evaluate, and of how its answers are used."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from yamsim_cli.core.episode.episode_rules import EndRule

from ..action_chunks import ChunkSettings
from ..policy_loading import is_external, takes_keywords


@dataclass(frozen=True)
class PolicyChoice:
    """A policy, how its answers are used, and its time limits.

    Attributes:
        name, folder: see `make_policy`.
        call_seconds: limit of real time for one answer or reset, s.
        time_limit: limit of simulated time for a trial, s; None for the task's own.
        end: who ends a trial.
        arguments: keywords for a class of the user.
        mapping: name or file of a config of `policies`, for another program's policy; None for the protocol's own.
        chunking: how chunks of actions are used.
        known_only: whether a class gets only those of `arguments` that it has parameters for.
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
        """The choice of another policy, by its name, under the same conditions.

        A class of the user gets the keywords that it has parameters for. A policy of another program gets the same
        config.
        """
        return replace(
            self,
            name=name,
            arguments=self.arguments if takes_keywords(name) else {},
            mapping=self.mapping if is_external(name) else None,
            known_only=True,
        )
