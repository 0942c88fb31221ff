from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from yamsim_cli.core.attempt_data import FailureCause
from yamsim_cli.core.config.goals.role_assignment import RoleAssignment
from yamsim_cli.core.config.program_task import ProgramTask
from yamsim_cli.core.geometry.cloth_folding import ClothFoldKind as FoldKind
from yamsim_cli.core.geometry.cloth_folding import FoldMove, fold_plans
from yamsim_cli.core.geometry.se3 import Array

from ..planning_context import MotionSegment, PlanningContext, SkillFailedError
from ..skill import Skill
from .cloth_motions import CARRY_SPEED, carry_points
from .point_grasps import PointGrasp, PointPlacement, reachable_grasps, target_on_point

_LAYERED_SPEED = 0.08  # m/s, in folds after the first: several layers come apart at a higher speed
_MAX_CORNER_ERROR = 0.02  # m, horizontal distance from its target below which a corner is already placed

# Folds that not every cloth's grid allows, and what they need; parts of an error message.
_NEEDS = {
    "diagonal": "along a diagonal: that needs equally many points along both sides",
    "thirds": "in thirds: that needs 6, 9, 12, ... points along a side",
}


class Fold(Skill):
    """Fold flat cloth: in half or in thirds with two hands, or along a diagonal with one hand.

    A partly folded cloth is folded further.
    """

    TYPICAL_SECONDS: ClassVar[float] = 6.8
    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    REQUIRES_HELD_OBJECT: ClassVar[bool | None] = False
    HANDLES_CLOTH: ClassVar[bool] = True
    ONE_HAND_ALTERNATIVE: ClassVar[str] = "fold `diagonal`"
    thing: str
    how: FoldKind = "half"

    @property
    def hand_count(self) -> int:
        """Hands that the fold needs."""
        return 1 if self.how == "diagonal" else 2

    def task_fault(self, task: ProgramTask) -> tuple[str, str] | None:
        """Check that the grid of each cloth can be folded."""
        for item in task.possible_objects(self.thing):
            if item.cloth is not None and not fold_plans(self.how, *reversed(item.cloth.grid)):
                grid = " x ".join(map(str, item.cloth.grid))
                return "how", f"the {item.name} cannot be folded {_NEEDS[self.how]}, not {grid}"
        return None

    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """Make the folds that are not yet made; see `Skill.run`."""
        thing = roles.object_of(self.thing)
        rows, columns = context.world.cloth_points(thing).shape[:2]
        plans = [plan.moves for plan in fold_plans(self.how, rows, columns)]
        last = len(plans[0]) - 1
        for number in range(last + 1):
            points = context.world.cloth_points(thing)
            plans = [moves for moves in plans if all(_is_folded(points, move) for move in moves[:number])]
            if number < last and any(_is_folded(points, moves[number]) for moves in plans):
                continue
            # Plans whose later moves are also within reach come first: their corners hardly move before.
            plans.sort(
                key=lambda moves: not all(_reachable_fold_grasps(context, thing, move) for move in moves[number + 1 :])
            )
            grasps = next(
                filter(None, (_reachable_fold_grasps(context, thing, moves[number]) for moves in plans)), None
            )
            if grasps is None:
                raise SkillFailedError(
                    FailureCause.UNREACHABLE, f"no hands reach corners of the {thing} and their targets"
                )
            yield from carry_points(context, thing, grasps, speed=_LAYERED_SPEED if number else CARRY_SPEED)


def _reachable_fold_grasps(context: PlanningContext, thing: str, move: FoldMove) -> list[PointGrasp] | None:
    return reachable_grasps(context, thing, [PointPlacement(one, target_on_point(other)) for one, other in move])


def _is_folded(points: Array, move: FoldMove) -> bool:
    return all(np.linalg.norm((points[one] - points[other])[:2]) < _MAX_CORNER_ERROR for one, other in move)
