"""Which policy is evaluated, and how its answers are used."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from ..episode.rules import EndRule
from ..policies.chunks import Chunking
from ..policies.loading import is_elsewhere, takes_keywords


@dataclass(frozen=True)
class PolicyChoice:
    """Which policy, how its answers are used, and how much time it has.

    Attributes:
        name, folder: see `make_policy`.
        call_seconds: for one answer, or a reset, of real time.
        time_limit: for a trial, of simulated time, s; None for the task's own.
        end: who ends a trial.
        arguments: keywords that the user's own policy is made with.
        mapping: name or file of a config of `policies`, for a policy from elsewhere; None for its protocol's own.
        chunking: how chunks of actions are used.
        known_only: whether a class is made with only those of `arguments` that it takes.
    """

    name: str
    folder: Path
    call_seconds: float = 30.0
    time_limit: float | None = None
    end: EndRule = EndRule.SUCCESS
    arguments: Mapping[str, int | float | str] = field(default_factory=dict)
    mapping: str | None = None
    chunking: Chunking = field(default_factory=Chunking)
    known_only: bool = False

    def compared_with(self, name: str) -> PolicyChoice:
        """Return the choice of another policy that is compared with this one, under the same conditions.

        A class of the user's gets those keywords that it takes, and a policy of another program the same config.

        Args:
            name: the other policy's, see `make_policy`.
        """
        return replace(
            self,
            name=name,
            arguments=self.arguments if takes_keywords(name) else {},
            mapping=self.mapping if is_elsewhere(name) else None,
            known_only=True,
        )
