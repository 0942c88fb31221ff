"""Choice of a policy to evaluate."""

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
        name: such as `scripted`, `file.py:Class` or `http://HOST:PORT`.
        folder: of the user's files, if their paths are relative.
        call_seconds: real time of one answer or reset, s.
        time_limit: simulated time of a trial, s; None for the task's limit.
        arguments: for the constructor of a class of the user.
        mapping: a config in `configs/policies/` or a file, for policies of other programs; None for the default.
        ignore_unknown_arguments: whether a class gets only the `arguments` that it accepts.
    """

    name: str
    folder: Path
    call_seconds: float = 30.0
    time_limit: float | None = None
    end: EndRule = EndRule.SUCCESS
    arguments: Mapping[str, int | float | str] = field(default_factory=dict)
    mapping: str | None = None
    chunking: ChunkSettings = field(default_factory=ChunkSettings)
    ignore_unknown_arguments: bool = False

    def compared_with(self, name: str) -> PolicyChoice:
        """Return the choice of the policy `name` with the same limits, end rule and chunk settings.

        A class of the user gets the keywords that it accepts. A policy of another program gets the same config.
        """
        return replace(
            self,
            name=name,
            arguments=self.arguments if takes_keywords(name) else {},
            mapping=self.mapping if is_external(name) else None,
            ignore_unknown_arguments=True,
        )
