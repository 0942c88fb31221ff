"""Whether articulated things are open, or closed."""

from __future__ import annotations

from typing import ClassVar, Literal

from ...documents.units import Share
from ..cast import Cast
from ..measure import Measure
from ..world import World
from .base import Predicate


class Open(Predicate):
    """A joint of each thing is open by a share of its range, or closed to it.

    Attributes:
        thing: a role.
        joint: the link's name, such as `drawer`.
        share: 0..1.
        side: "least": open at least so far; "most": at most.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    thing: str
    joint: str
    share: Share = 0.7
    side: Literal["least", "most"] = "least"

    def measures(self, world: World, cast: Cast) -> list[Measure]:
        """See `Predicate`."""
        return [self._measure(world, thing) for thing in cast.of(self.thing)]

    def _measure(self, world: World, thing: str) -> Measure:
        opening = world.opening(thing, self.joint)
        margin = opening - self.share if self.side == "least" else self.share - opening
        return Measure(f"open({thing}, {self.joint})", margin, "share", f"open by {opening:.0%}")
