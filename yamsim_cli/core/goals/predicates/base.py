"""What every predicate is: its arguments as a config, and a function of the world."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

from ...documents.base import Config
from ..cast import Cast
from ..measure import Measure, either
from ..world import World


class Predicate(Config):
    """Base of the predicates. A subclass's fields are its arguments; those that name a role are listed in `ROLES`."""

    ROLES: ClassVar[tuple[str, ...]]
    # Whether its first role has to be in a hand (True) or in none (False); None where either may be.
    IN_HAND: ClassVar[bool | None] = None
    # Whether it is asked of cloth alone.
    OF_CLOTH: ClassVar[bool] = False

    @abstractmethod
    def measures(self, world: World, cast: Cast) -> list[Measure]:
        """One measure for each thing, or pair of things, that it is about: all have to hold."""

    def roles(self) -> tuple[tuple[str, str], ...]:
        """The arguments that name roles, and the roles."""
        return tuple((field, role) for field in self.ROLES if (role := getattr(self, field)) is not None)


def still_held(world: World, thing: str, what: str) -> Measure | None:
    """The measure of a predicate `what` that fails since hands hold a thing; None where none does."""
    holders = world.holders(thing)
    return either(what, False, f"the {' and the '.join(sorted(holders))} hand holds it") if holders else None
