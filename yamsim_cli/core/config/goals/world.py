"""The protocol by which predicates query the state of a scene."""

from __future__ import annotations

from typing import Protocol

from ...geometry.se3 import Array

# The name of the work surface. Objects stand on it unless a task places them on another object.
TABLE = "table"


class GoalWorld(Protocol):
    """The current state of a scene, by the names of its objects. Units are m and rad; poses are in `world`.

    Every query raises `KeyError` for an unknown name.
    """

    def pose(self, thing: str) -> Array:
        """Return the pose (4, 4) of an object's frame."""

    def start_pose(self, thing: str) -> Array:
        """Return the pose (4, 4) of an object's frame at the start of the attempt."""

    def handle_pose(self, thing: str, handle: str) -> Array:
        """Return the pose (4, 4) of a handle of an object's base; z points into the handle."""

    def aabb(self, thing: str) -> tuple[Array, Array]:
        """Return the lowest and the highest corner (3,) of an object's axis-aligned bounding box."""

    def start_aabb(self, thing: str) -> tuple[Array, Array]:
        """Return the corners of `aabb` at the start of the attempt."""

    def are_touching(self, one: str, other: str) -> bool:
        """Return whether two objects touch; `TABLE` may be one of them."""

    def holding_sides(self, thing: str) -> frozenset[str]:
        """Return the sides, "left" and "right", of the hands that hold an object."""

    def holders_since_rest(self, thing: str) -> tuple[str, ...]:
        """Return the sides of the hands that held an object since it last lay down, in order."""

    def handovers(self, thing: str) -> tuple[tuple[str, str], ...]:
        """Return all handovers of an object since the attempt began, in order: sides of giver and receiver."""

    def volume_fraction_inside(self, thing: str, container: str) -> float:
        """Return the share, 0..1, of an object's volume in the space that a container's walls enclose."""

    def grams_inside(self, filled: str, container: str) -> float:
        """Return the mass of the loose pieces of a filled object whose centres are inside a container, g."""

    def cloth_points(self, thing: str) -> Array:
        """Return the points (rows, columns, 3) of a cloth; rows run along the cloth's x axis."""

    def joint_opening(self, thing: str, joint: str) -> float:
        """Return the opening of an articulated object's joint: 0 at the lower end of its range, 1 at the upper end."""
