"""The assignment of objects to roles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class RoleAssignment:
    """The objects of an attempt by their roles in the task.

    Attributes:
        objects_by_role: role -> names of its objects, in order. A single object usually has the name of its role.
        config_names: object -> the name of its config, such as `cup`.
        scale_factors: object -> scale factor of its lengths; empty if all roles have one size.
    """

    objects_by_role: Mapping[str, tuple[str, ...]]
    config_names: Mapping[str, str]
    scale_factors: Mapping[str, float] = field(default_factory=dict)

    def objects_of(self, role: str) -> tuple[str, ...]:
        """Return the names of a role's objects; for a name that is no role, such as `table`, that name alone."""
        return self.objects_by_role.get(role) or (role,)

    def object_of(self, role: str) -> str:
        """Return the name of a role's first object."""
        return self.objects_of(role)[0]

    def object_pairs(self, role: str, other: str) -> Iterator[tuple[str, str]]:
        """Yield each object of a role with its counterpart of another role.

        Roles with equal numbers of objects are paired in order. Otherwise, the counterpart is the other role's first.
        """
        ones, others = self.objects_of(role), self.objects_of(other)
        if len(ones) == len(others):
            yield from zip(ones, others, strict=True)
        else:
            yield from ((one, others[0]) for one in ones)
