"""A skill that folds cloth by moving corners onto other points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from yamsim_cli.core.config.goals.cast import Cast
from yamsim_cli.core.geometry.folding import Fold as FoldKind
from yamsim_cli.core.geometry.folding import Move, fold_plans
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.types import Cause

from ..base import Skill
from ..bench import Bench, Segment, SkillFailedError
from .hands import SPEED, carry
from .reach import PointGrasp, PointPlacement, onto_point, reachable_grasps

_LAYERED_SPEED = 0.08  # m/s, of folds after the first: several layers come apart at a higher speed
_PLACED = 0.02  # m, horizontal distance from its target below which a corner counts as placed already


class Fold(Skill):
    """Fold flat cloth: in half or in thirds with two hands, along a diagonal with one.

    A cloth that is partly folded already is folded further.

    Attributes:
        thing: a role, which cloth plays.
        how: kind of fold.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    NEEDS_HELD: ClassVar[bool | None] = False
    OF_CLOTH: ClassVar[bool] = True
    thing: str
    how: FoldKind = "half"

    @property
    def hands(self) -> int:
        """The number of hands that the fold needs."""
        return 1 if self.how == "diagonal" else 2

    @property
    def said(self) -> str:
        """The kind of fold, as a phrase."""
        return {"half": "in half", "diagonal": "along a diagonal", "thirds": "in thirds"}[self.how]

    def run(self, bench: Bench, cast: Cast, ahead: Sequence[Skill]) -> Iterator[Segment]:
        """See `Skill`."""
        thing = cast.one(self.thing)
        rows, columns = bench.world.points(thing).shape[:2]
        plans = [plan.moves for plan in fold_plans(self.how, rows, columns)]
        last = len(plans[0]) - 1
        for number in range(last + 1):
            points = bench.world.points(thing)
            plans = [moves for moves in plans if all(_is_done(points, move) for move in moves[:number])]
            if number < last and any(_is_done(points, moves[number]) for moves in plans):
                continue
            # Plans whose later moves are within reach too come first: later corners hardly move before.
            plans.sort(key=lambda moves: not all(_grasps(bench, thing, move) for move in moves[number + 1 :]))
            grasps = next(filter(None, (_grasps(bench, thing, moves[number]) for moves in plans)), None)
            if grasps is None:
                raise SkillFailedError(
                    Cause.UNREACHABLE, f"no hands reach corners of the {thing} and where they are to lie"
                )
            yield from carry(bench, thing, grasps, speed=_LAYERED_SPEED if number else SPEED)


def _grasps(bench: Bench, thing: str, move: Move) -> list[PointGrasp] | None:
    return reachable_grasps(bench, thing, [PointPlacement(one, onto_point(other)) for one, other in move])


def _is_done(points: Array, move: Move) -> bool:
    """Whether every corner of a move lies on its target already."""
    return all(np.linalg.norm((points[one] - points[other])[:2]) < _PLACED for one, other in move)
