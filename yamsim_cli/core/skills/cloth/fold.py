"""Fold cloth: take it at corners and lay them onto others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from ...geometry.folding import Fold as Way
from ...geometry.folding import Move, ways_to_fold
from ...geometry.se3 import Array
from ...goals.cast import Cast
from ...types import Cause
from ..base import Skill
from ..bench import Bench, Segment, SkillFailedError
from .hands import SPEED, carry
from .reach import Lay, Taken, onto, reached

# Several layers come apart where they are hurried, m/s.
_SLOWLY = 0.08

# A corner that is laid already is as near to where it belongs, seen from above, m.
_LAID = 0.02


class Fold(Skill):
    """Fold cloth that lies flat: in half or in thirds with two hands, along a diagonal with one.

    What is folded in part already is folded on.

    Attributes:
        thing: a role, which cloth plays.
        how: which way.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    NEEDS_HELD: ClassVar[bool | None] = False
    OF_CLOTH: ClassVar[bool] = True
    thing: str
    how: Way = "half"

    @property
    def hands(self) -> int:
        """How many it takes."""
        return 1 if self.how == "diagonal" else 2

    @property
    def said(self) -> str:
        """Which way, in words."""
        return {"half": "in half", "diagonal": "along a diagonal", "thirds": "in thirds"}[self.how]

    def run(self, bench: Bench, cast: Cast, ahead: Sequence[Skill]) -> Iterator[Segment]:
        """See `Skill`."""
        thing = cast.one(self.thing)
        rows, columns = bench.world.points(thing).shape[:2]
        ways = [way.moves for way in ways_to_fold(self.how, rows, columns)]
        last = len(ways[0]) - 1
        for number in range(last + 1):
            points = bench.world.points(thing)
            ways = [moves for moves in ways if all(_laid(points, move) for move in moves[:number])]
            if number < last and any(_laid(points, moves[number]) for moves in ways):
                continue
            # Where what comes later lies as it will, or nearly, hands have to reach that too.
            ways.sort(key=lambda moves: not all(_reached(bench, thing, move) for move in moves[number + 1 :]))
            taken = next(filter(None, (_reached(bench, thing, moves[number]) for moves in ways)), None)
            if taken is None:
                raise SkillFailedError(
                    Cause.UNREACHABLE, f"no hands reach corners of the {thing} and where they are to lie"
                )
            yield from carry(bench, thing, taken, speed=_SLOWLY if number else SPEED)


def _reached(bench: Bench, thing: str, move: Move) -> list[Taken] | None:
    return reached(bench, thing, [Lay(one, onto(other)) for one, other in move])


def _laid(points: Array, move: Move) -> bool:
    """Whether a move was made already."""
    return all(np.linalg.norm((points[one] - points[other])[:2]) < _LAID for one, other in move)
