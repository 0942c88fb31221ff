"""Fold cloth: take it at corners and lay them onto others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import ClassVar

from ..geometry.folding import Fold as Way
from ..goals.cast import Cast
from ..types import Cause
from .base import Skill
from .bench import Bench, Segment
from .cloth_hands import Lay, carry, onto, reached
from .errors import SkillFailedError


class Fold(Skill):
    """Fold cloth that lies flat once: in half with two hands, along a diagonal with one.

    Attributes:
        thing: a role, which cloth plays.
        how: which way.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    NEEDS: ClassVar[bool | None] = False
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
        return {"half": "in half", "diagonal": "along a diagonal"}[self.how]

    def run(self, bench: Bench, cast: Cast, ahead: Sequence[Skill]) -> Iterator[Segment]:
        """See `Skill`."""
        thing = cast.one(self.thing)
        rows, columns = bench.world.points(thing).shape[:2]
        for lays in _moves(self.how, rows, columns):
            if taken := reached(bench, thing, lays):
                yield from carry(bench, thing, taken)
                return
        raise SkillFailedError(Cause.UNREACHABLE, f"no hands reach corners of the {thing} and where they are to lie")


def _moves(how: Way, rows: int, columns: int) -> list[list[Lay]]:
    """The moves that fold a grid of points so, each in its own way."""
    last = (rows - 1, columns - 1)
    if how == "diagonal":
        corners = [(0, 0), (0, last[1]), (last[0], 0), last]
        return [[Lay(one, onto((last[0] - one[0], last[1] - one[1])))] for one in corners]
    low, high = ((0, 0), (0, last[1])), ((last[0], 0), last)
    left, right = ((0, 0), (last[0], 0)), ((0, last[1]), last)
    moves = ((low, high), (high, low), (left, right), (right, left))
    return [[Lay(one, onto(other)) for one, other in zip(*move, strict=True)] for move in moves]
