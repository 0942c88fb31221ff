"""Which things play which roles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class RoleAssignment:
    """The things of an attempt by the roles that a task gives them.

    Attributes:
        objects_by_role: role -> names of the things that play it, in order. The only thing of a role is called as the role.
        config_names: thing -> the name of its object config, such as `cup`.
        scale_factors: thing -> scale factor of its lengths; empty where roles have one size.
    """

    objects_by_role: Mapping[str, tuple[str, ...]]
    config_names: Mapping[str, str]
    scale_factors: Mapping[str, float] = field(default_factory=dict)

    def objects_of(self, role: str) -> tuple[str, ...]:
        """The things that play a role; any other name stands for the thing of that name."""
        return self.objects_by_role.get(role) or (role,)

    def object_of(self, role: str) -> str:
        """The first thing that plays a role."""
        return self.objects_of(role)[0]

    def pairs(self, role: str, other: str) -> Iterator[tuple[str, str]]:
        """Each thing of a role with its counterpart of another role.

        Roles with equally many things are paired in order; else every thing is paired with the other role's first.
        """
        ones, others = self.objects_of(role), self.objects_of(other)
        if len(ones) == len(others):
            yield from zip(ones, others, strict=True)
        else:
            yield from ((one, others[0]) for one in ones)
