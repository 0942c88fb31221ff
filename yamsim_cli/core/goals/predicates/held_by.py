"""Whether a hand holds things."""

from __future__ import annotations

from typing import ClassVar, Literal

from ..cast import Cast
from ..measure import Measure, either
from ..world import World
from .base import Predicate


class HeldBy(Predicate):
    """Both fingers of a hand press on each thing.

    Attributes:
        thing: a role.
        arm: which hand; "both" asks for both of them at once.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    IN_HAND: ClassVar[bool | None] = True
    thing: str
    arm: Literal["left", "right", "either", "both"] = "either"

    def measures(self, world: World, cast: Cast) -> list[Measure]:
        """See `Predicate`."""
        return [self._measure(world, thing) for thing in cast.of(self.thing)]

    def _measure(self, world: World, thing: str) -> Measure:
        holders = world.holders(thing)
        match self.arm:
            case "either":
                holds = bool(holders)
            case "both":
                holds = len(holders) == 2
            case side:
                holds = holders == {side}
        said = f"held by the {' and the '.join(sorted(holders))} hand" if holders else "no hand holds it"
        return either(f"held_by({thing}, {self.arm})", holds, said)
