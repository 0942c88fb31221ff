"""Which things play which roles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Cast:
    """The things of an attempt by the roles that a task gives them.

    Attributes:
        things: role -> names of the things that play it, in order. The only thing of a role is called as the role.
        kinds: thing -> the name of its object config, such as `cup`.
        sizes: thing -> scale factor of its lengths; empty where roles have one size.
    """

    things: Mapping[str, tuple[str, ...]]
    kinds: Mapping[str, str]
    sizes: Mapping[str, float] = field(default_factory=dict)

    def of(self, role: str) -> tuple[str, ...]:
        """The things that play a role; any other name stands for the thing of that name."""
        return self.things.get(role) or (role,)

    def one(self, role: str) -> str:
        """The first thing that plays a role."""
        return self.of(role)[0]

    def pairs(self, role: str, other: str) -> Iterator[tuple[str, str]]:
        """Each thing of a role with its counterpart of another role.

        Roles with equally many things are paired in order; else every thing is paired with the other role's first.
        """
        ones, others = self.of(role), self.of(other)
        if len(ones) == len(others):
            yield from zip(ones, others, strict=True)
        else:
            yield from ((one, others[0]) for one in ones)
