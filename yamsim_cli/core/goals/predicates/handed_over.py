"""Whether things went from hand to hand."""

from __future__ import annotations

from itertools import pairwise
from typing import ClassVar, Literal

from ..cast import Cast
from ..measure import Measure, either
from ..world import World
from .base import Predicate


class HandedOver(Predicate):
    """Each thing went from one hand to the other in the air, and has not been put down since.

    Attributes:
        thing: a role.
        to: the hand that has to have taken it.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    IN_HAND: ClassVar[bool | None] = True
    thing: str
    to: Literal["left", "right", "either"] = "either"

    def measures(self, world: World, cast: Cast) -> list[Measure]:
        """See `Predicate`."""
        return [self._measure(world, thing) for thing in cast.of(self.thing)]

    def _measure(self, world: World, thing: str) -> Measure:
        hands = world.passed_to(thing)
        taken = [taker for giver, taker in pairwise(hands) if giver != taker]
        holds = bool(taken) if self.to == "either" else self.to in taken
        return either(f"handed_over({thing}, {self.to})", holds, f"held by: {', '.join(hands) or 'no hand'}")
