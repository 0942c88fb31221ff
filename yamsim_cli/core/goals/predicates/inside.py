"""Whether things lie in a container."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field

from ...documents.units import Share
from ..cast import Cast
from ..measure import Measure
from ..world import World
from .base import Predicate, still_held


class Inside(Predicate):
    """So large a share of each thing's volume lies in its container's interior, and no hand holds it.

    Attributes:
        thing, container: roles.
        share: 0..1.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "container")
    thing: str
    container: str
    share: Annotated[Share, Field(gt=0)] = 0.8

    def measures(self, world: World, cast: Cast) -> list[Measure]:
        """See `Predicate`."""
        return [self._measure(world, *pair) for pair in cast.pairs(self.thing, self.container)]

    def _measure(self, world: World, thing: str, container: str) -> Measure:
        what = f"in({thing}, {container})"
        if held := still_held(world, thing, what):
            return held
        share = world.share_inside(thing, container)
        return Measure(what, share - self.share, "share", f"{share:.0%} of it inside, of {self.share:.0%} asked")
