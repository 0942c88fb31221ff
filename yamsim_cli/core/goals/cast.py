"""Who plays which role in an attempt."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Cast:
    """The things of an attempt by the roles that a task gives them.

    Attributes:
        things: role -> names of the things that play it, in order. A role that one thing plays gives it its own name.
        kinds: thing -> which config it was made of, such as `cup`.
        sizes: thing -> by how much its lengths differ from the config's, a factor; none where roles have one size.
    """

    things: Mapping[str, tuple[str, ...]]
    kinds: Mapping[str, str]
    sizes: Mapping[str, float] = field(default_factory=dict)

    def of(self, role: str) -> tuple[str, ...]:
        """The things that play a role, or the one thing of that very name."""
        return self.things.get(role) or (role,)

    def one(self, role: str) -> str:
        """The first thing that plays a role."""
        return self.of(role)[0]

    def pairs(self, role: str, other: str) -> Iterator[tuple[str, str]]:
        """Every thing of a role with the thing of another role that it belongs to.

        Where as many play the one as the other, the first belongs to the first and so on; else all belong to the other
        role's first.
        """
        ones, others = self.of(role), self.of(other)
        if len(ones) == len(others):
            yield from zip(ones, others, strict=True)
        else:
            yield from ((one, others[0]) for one in ones)
