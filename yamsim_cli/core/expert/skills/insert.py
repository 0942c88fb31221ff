from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from ...config.goals.role_assignment import RoleAssignment
from ...geometry.se3 import Array, pose, rotation_z, yaw
from .place import PlaceSkill
from .planning_context import PlanningContext

# m, grid of places in a container. The finer step is used if no place of the coarse grid is free down to the floor.
_GRID_STEPS = (0.03, 0.01)
# m above a container's lowest point; an object with a lowest point below this counts as standing on the floor.
_FLOOR_MARGIN = 0.02
_HEIGHT_STEP = 0.01  # m, resolution of resting heights; at equal height the more central place is better

# share of a fallen object's volume in the container, from which it counts as inserted; tall objects stick out
_MIN_SHARE_INSIDE = 0.3

# shares of a container's height; a place must be inside the container at one of them. A container's bounding box also
# covers space outside its walls, such as under a mug's handle.
_CHECKED_HEIGHT_SHARES = (0.25, 0.5, 0.75)

_MAX_TILT = math.radians(3.0)  # rad, an object that tilts more may also keep its tilt in the container

# rad, headings relative to the container; earlier ones come first among goals that are equally low and central
_OBJECT_HEADINGS = tuple(math.radians(angle) for angle in (0, 180, 90, -90))


class Insert(PlaceSkill):
    """Put a held object where it rests lowest in the container `into`, near the container's middle."""

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "into")
    into: str

    def support_name(self, roles: RoleAssignment) -> str:
        """Return the name of the container."""
        return roles.object_of(self.into)

    def goal_poses(self, context: PlanningContext, roles: RoleAssignment, thing: str) -> list[Array]:
        """Return goal poses in the container, upright ones first; a tilted object may also keep its tilt."""
        container = roles.object_of(self.into)
        bottom, floor = context.world.local_box(thing)[0][2], context.world.aabb(container)[0][2] + _FLOOR_MARGIN
        upright = list[Array]()
        for step in _GRID_STEPS:
            upright = self._upright_goals(context, container, thing, step)
            if any(T_goal[2, 3] + bottom < floor for T_goal in upright):
                break
        return upright + _tilted_goals(context, thing, container, upright)

    def _upright_goals(self, context: PlanningContext, container: str, thing: str, step: float) -> list[Array]:
        T, (low, high) = context.world.pose(container), context.world.local_box(container)
        heights = low[2] + np.array(_CHECKED_HEIGHT_SHARES) * (high - low)[2]
        found = []
        for turn in _OBJECT_HEADINGS:
            heading = yaw(T) + turn
            half = context.half_footprint(thing, turn)
            ranges = [(low[k] + half[k], high[k] - half[k]) for k in (0, 1)]
            if any(first > last for first, last in ranges):
                continue
            middles = [(first + last) / 2 for first, last in ranges]
            for x, y in itertools.product(*(_grid_coordinates(first, last, step) for first, last in ranges)):
                if not context.world.points_inside(
                    container, np.array([(T @ (x, y, z, 1.0))[:3] for z in heights])
                ).any():
                    continue
                place = (T @ (x, y, 0.0, 1.0))[:2]
                height = context.rest_height_over(thing, place, container, heading)
                offset = float(np.hypot(x - middles[0], y - middles[1]))
                found.append((round(height / _HEIGHT_STEP), offset, pose((*place, height), rotation_z(heading))))
        return [T_goal for *_, T_goal in sorted(found, key=lambda each: each[:2])]

    def _require_placed(self, context: PlanningContext, thing: str, onto: str, T_goal: Array) -> None:
        if context.world.volume_fraction_inside(thing, onto) < _MIN_SHARE_INSIDE:
            super()._require_placed(context, thing, onto, T_goal)


def _grid_coordinates(first: float, last: float, step: float) -> Array:
    return np.linspace(first, last, max(1, math.ceil((last - first) / step)) + 1)


def _tilted_goals(context: PlanningContext, thing: str, container: str, upright: Sequence[Array]) -> list[Array]:
    """Return upright goals changed to an object's present tilt; empty if it hardly tilts."""
    T_now = context.world.pose(thing)
    if T_now[2, 2] > math.cos(_MAX_TILT):
        return []
    goals = []
    for T_upright in upright:
        T_goal = pose(T_upright[:3, 3], rotation_z(yaw(T_upright) - yaw(T_now)) @ T_now[:3, :3])
        T_goal[2, 3] = context.rest_height_of(thing, T_goal, container)
        goals.append(T_goal)
    return goals
