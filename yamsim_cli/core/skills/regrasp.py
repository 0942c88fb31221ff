"""Put a thing down at a free place, to take it another way."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import ClassVar

from ..goals.cast import Cast
from .base import Side, Skill
from .bench import Bench, Segment
from .pick import Pick
from .put_aside import PutAside


class Regrasp(Skill):
    """Put a thing down and take it again, with the arm and the grip that suit what follows.

    Attributes:
        thing: a role; it is in a hand.
        arm: which arm takes it.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    NEEDS: ClassVar[bool | None] = True
    LEAVES: ClassVar[bool | None] = True
    thing: str
    arm: Side = "any"

    def run(self, bench: Bench, cast: Cast, ahead: Sequence[Skill]) -> Iterator[Segment]:
        """See `Skill`."""
        yield from PutAside(thing=self.thing).run(bench, cast, ())
        yield from Pick(thing=self.thing, arm=self.arm).run(bench, cast, ahead)
