"""Whether things went from hand to hand at any time in the attempt."""

from __future__ import annotations

from typing import ClassVar, Literal

from ..cast import Cast
from ..measure import Measure, either
from ..world import World
from .base import Predicate


class WasHandedOver(Predicate):
    """Each thing went from one hand to the other in the air since the attempt began; it may have been put down since.

    Attributes:
        thing: a role.
        to: the hand that took it.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    thing: str
    to: Literal["left", "right", "either"] = "either"

    def measures(self, world: World, cast: Cast) -> list[Measure]:
        """See `Predicate`."""
        return [self._measure(world, thing) for thing in cast.of(self.thing)]

    def _measure(self, world: World, thing: str) -> Measure:
        passed = world.handovers(thing)
        said = ", ".join(f"from {giver} to {taker}" for giver, taker in passed) or "never from hand to hand"
        holds = any(self.to in ("either", taker) for _, taker in passed)
        return either(f"was_handed_over({thing}, {self.to})", holds, said)
