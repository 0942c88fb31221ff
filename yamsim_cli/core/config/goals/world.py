"""The state of a scene as predicates query it."""

from __future__ import annotations

from typing import Protocol

from ...geometry.se3 import Array

# The name of the work surface, on which things stand unless a task places them on another thing.
TABLE = "table"


class GoalWorld(Protocol):
    """The present state of a scene, by the names of its things. Metres, radians, poses in `world`.

    Every query raises `KeyError` for a name that is no thing of the scene.
    """

    def pose(self, thing: str) -> Array:
        """Pose (4, 4) of a thing's frame."""

    def start_pose(self, thing: str) -> Array:
        """Pose (4, 4) of a thing's frame when the attempt began."""

    def handle_pose(self, thing: str, handle: str) -> Array:
        """Pose (4, 4) of a handle of a thing's base, z pointing into it; `KeyError` if there is no such handle."""

    def aabb(self, thing: str) -> tuple[Array, Array]:
        """The lowest and the highest corner (3,) of a thing's bounding box along the axes of `world`."""

    def touching(self, one: str, other: str) -> bool:
        """Whether two things touch; `TABLE` may be one of them."""

    def holding_sides(self, thing: str) -> frozenset[str]:
        """The sides, "left" and "right", of the hands that have a thing between both of their fingers."""

    def holders_since_rest(self, thing: str) -> tuple[str, ...]:
        """The sides of the hands that held a thing since it last lay down, in order."""

    def handovers(self, thing: str) -> tuple[tuple[str, str], ...]:
        """All handovers of a thing since the attempt began, in order: sides of the giving and the receiving hand."""

    def volume_fraction_inside(self, thing: str, container: str) -> float:
        """The share, 0..1, of a thing's volume in a container's interior: the space that its walls enclose."""

    def cloth_points(self, thing: str) -> Array:
        """The points of a cloth (along y, along x, 3), by rows along its own x axis."""

    def joint_opening(self, thing: str, joint: str) -> float:
        """How far a joint of an articulated thing is open: 0 at the lower end of its range, 1 at the upper end."""
