"""`PressLevel`: press a tilted object level, such as a bowl that lies askew in a larger one."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from ..core.config.goals.role_assignment import RoleAssignment
from ..core.expert.skills.planning_context import MotionSegment, PlanningContext
from ..core.expert.skills.skill import Skill
from ..core.geometry.se3 import Array
from .pressing import press_point

# Of the tilt; an object with a larger cosine is level. Bowls that lay askew were tilted by 12 to 17 degrees.
_LEVEL_COSINE = math.cos(math.radians(4))
_MAX_PRESSES = 2  # a press takes 5 to 9 of the 80 actions that KitchenBench allows
# m below the rim's highest point, where the descent ends: a bowl 141 mm wide was 31 mm higher on one side
_PRESSED = 0.025


class PressLevel(Skill):
    """Press closed fingers onto the highest part of a tilted object's rim; do nothing if it is level."""

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    REQUIRES_HELD_OBJECT: ClassVar[bool | None] = False
    thing: str

    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """Yield the motions; see `Skill.run`. An object out of reach, or upside down, stays as it is."""
        thing = roles.object_of(self.thing)
        for _ in range(_MAX_PRESSES):
            if not 0.0 < context.world.pose(thing)[2, 2] <= _LEVEL_COSINE:
                return
            yield from press_point(context, _highest_rim_point(context, thing), _PRESSED)


def _highest_rim_point(context: PlanningContext, thing: str) -> Array:
    """Return the point (3,) of a round object's rim that its tilt raises most, in `world`, m."""
    T, high = context.world.pose(thing), context.world.local_box(thing)[1]
    uphill = T[2, :2] / np.linalg.norm(T[2, :2])
    point: Array = (T @ (*(high[:2].min() * uphill), high[2], 1.0))[:3]
    return point
