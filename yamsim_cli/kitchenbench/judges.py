"""Who says whether a scene in motion has come to its goal: the benchmark's checker, or a goal of ours."""

from __future__ import annotations

from typing import Any, Protocol

from kitchenbench.sim import make_success_checker

from ..core.episode.rules import EndRule
from .motion import Motion
from .own import OwnRealization
from .scene import Realization
from .world import KitchenWorld


class Judge(Protocol):
    """Looks at a scene in motion.

    Attributes:
        instruction: what is said at the beginning.
        unrealized: what the scene asks for and does not get, as sentences.
        noted: what every step's `info` has besides.
    """

    instruction: str
    unrealized: tuple[str, ...]
    noted: dict[str, Any]

    def look(self) -> tuple[bool, str]:
        """Whether the goal is reached now, and how it stands, for a person."""


class KitchenJudge:
    """The benchmark's own checker, asked after every action, and nothing else. See `Judge`.

    Attributes:
        world: what it asks.
    """

    def __init__(self, realized: Realization, motion: Motion) -> None:
        self.instruction, self.unrealized = realized.blueprint.instruction, realized.unrealized
        self.noted = {"contract_version": realized.blueprint.contract_version}
        self.world = KitchenWorld(realized, motion)
        self._checker = make_success_checker(realized.blueprint, self.world)

    def look(self) -> tuple[bool, str]:
        """What the checker says."""
        verdict = self._checker(self.world)
        return bool(verdict.success), str(verdict.explanation)


class OwnJudge:
    """A task's goal, which the episode itself judges after every control tick. See `Judge`."""

    def __init__(self, realized: OwnRealization, motion: Motion) -> None:
        self.instruction = realized.instruction
        self.unrealized: tuple[str, ...] = ()
        self.noted: dict[str, Any] = {"end_rule": EndRule.SUCCESS.value}
        self._episode = motion.episode

    def look(self) -> tuple[bool, str]:
        """How the goal stands."""
        return self._episode.succeeds, self._episode.status
