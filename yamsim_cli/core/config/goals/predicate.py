"""Base classes of the predicates of goals."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

from ...files.documents.config_base import Config
from .measure import GoalMeasure, binary_measure
from .role_assignment import RoleAssignment
from .world import GoalWorld


class Predicate(Config):
    """Base of all predicates. Fields are the arguments of a predicate; `ROLES` lists the arguments that name roles."""

    ROLES: ClassVar[tuple[str, ...]]
    # Whether objects of the first role have to be in a hand (True) or in no hand (False); None if both are possible.
    IN_HAND: ClassVar[bool | None] = None
    # Arguments that may name `table`, and arguments that may name a region of the task.
    TABLE_ARGUMENTS: ClassVar[tuple[str, ...]] = ()
    REGION_ARGUMENTS: ClassVar[tuple[str, ...]] = ()
    # Whether only cloth may have the roles.
    JUDGES_CLOTH: ClassVar[bool] = False

    @abstractmethod
    def measures(self, world: GoalWorld, roles: RoleAssignment) -> list[GoalMeasure]:
        """Return one or more measures for each object or pair of objects; all have to hold."""

    def roles(self) -> tuple[tuple[str, str], ...]:
        """Return pairs of an argument that names a role, and the role."""
        return tuple((field, role) for field in self.ROLES if (role := getattr(self, field)) is not None)


class PerObjectPredicate(Predicate):
    """A predicate that each object of a role has to fulfil."""

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    thing: str

    def measures(self, world: GoalWorld, roles: RoleAssignment) -> list[GoalMeasure]:
        """Return the measures of each object of the role."""
        return [measure for thing in roles.objects_of(self.thing) for measure in self._object_measures(world, thing)]

    def _object_measures(self, world: GoalWorld, thing: str) -> list[GoalMeasure]:
        return [self._measure_object(world, thing)]

    def _measure_object(self, world: GoalWorld, thing: str) -> GoalMeasure:
        raise NotImplementedError


class PerPairPredicate(Predicate):
    """A predicate on each pair of objects of two roles, as `RoleAssignment.object_pairs` assigns them."""

    thing: str

    def measures(self, world: GoalWorld, roles: RoleAssignment) -> list[GoalMeasure]:
        """Return the measure of each pair."""
        return [
            self._measure_pair(world, *pair) for pair in roles.object_pairs(self.thing, getattr(self, self.ROLES[1]))
        ]

    @abstractmethod
    def _measure_pair(self, world: GoalWorld, thing: str, other: str) -> GoalMeasure: ...


def failure_if_held(world: GoalWorld, thing: str, what: str) -> GoalMeasure | None:
    """Return a failed measure if a hand holds the object; None otherwise."""
    holders = world.holding_sides(thing)
    return binary_measure(what, False, f"the {' and the '.join(sorted(holders))} hand holds it") if holders else None
