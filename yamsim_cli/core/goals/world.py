"""What a goal asks of the world: facts in numbers, whoever knows them."""

from __future__ import annotations

from typing import Protocol

from ..geometry.se3 import Array

# What everything stands on unless it stands on something else.
TABLE = "table"


class World(Protocol):
    """The state of a scene at one moment, by the names of the things in it. Metres, radians, poses in `world`.

    Every query raises `KeyError` for a name that is no thing of the scene.
    """

    def pose(self, thing: str) -> Array:
        """Pose (4, 4) of a thing's frame."""
        ...

    def mark(self, thing: str, handle: str) -> Array:
        """Pose (4, 4) of a handle of a thing's base, its z the way into it; `KeyError` if it has none of that name."""
        ...

    def bounds(self, thing: str) -> tuple[Array, Array]:
        """The lowest and the highest corner (3,) of the block along the world's axes that encloses a thing."""
        ...

    def start(self, thing: str) -> Array:
        """Pose (4, 4) of a thing's frame when the attempt began."""
        ...

    def speed(self, thing: str) -> float:
        """Speed of a thing's origin, m/s."""
        ...

    def touching(self, one: str, other: str) -> bool:
        """Whether two things touch; `TABLE` may be one of them."""
        ...

    def holders(self, thing: str) -> frozenset[str]:
        """The sides, "left" and "right", of the hands that have a thing between both of their fingers."""
        ...

    def passed_to(self, thing: str) -> tuple[str, ...]:
        """The sides of the hands that held a thing so far, in order; it never lay down between two of them."""
        ...

    def handovers(self, thing: str) -> tuple[tuple[str, str], ...]:
        """All handovers of a thing since the attempt began, in order: the sides of the giving and the taking hand.

        Unlike `passed_to`, it keeps them when the thing is put down.
        """
        ...

    def share_inside(self, thing: str, container: str) -> float:
        """The share, 0..1, of a thing's volume that lies in a container's interior: the room that its walls enclose."""
        ...

    def points(self, thing: str) -> Array:
        """Where the points of a cloth are (along y, along x, 3), by rows along its own x axis."""
        ...

    def opening(self, thing: str, joint: str) -> float:
        """How far a joint of an articulated thing is open: 0 at the lower end of its range, 1 at the upper end."""
        ...
