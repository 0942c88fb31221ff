"""Sort what lies about into the compartments for it, the uppermost first, in the order in which it turns out to go."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar

from ..core.goals.cast import Cast
from ..core.goals.world import World
from ..core.skills.base import Skill, holder_of
from ..core.skills.bench import Bench, Segment
from ..core.skills.errors import SkillFailedError
from ..core.skills.handover import Handover
from ..core.skills.insert import Insert
from ..core.skills.moves import recover
from ..core.skills.pick import Pick
from ..core.skills.put_aside import PutAside

_LOG = logging.getLogger("yamsim")

# So much of a thing's volume is to be in its compartment, from 0 to 1: a little more than the benchmark asks.
_INSIDE = 0.85
# How often each thing is tried, and at which time it is put aside first, or handed over.
_TRIES, _ASIDE, _HANDED = 3, 2, 3
# So high cutlery clears the tray's wall, also as it hangs in the fingers, m; and hands meet so high over the table.
_LIFT, _MEETING = 0.06, 0.25


class Sort(Skill):
    """Bring every thing into the compartment of its kind. What lies in it already stays there.

    Attributes:
        things: a role.
        into: kind of thing -> its compartment.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("things",)
    things: str
    into: Mapping[str, str]

    def run(self, bench: Bench, cast: Cast, ahead: Sequence[Skill]) -> Iterator[Segment]:
        """See `Skill`."""
        tries: dict[str, int] = {}
        said = ""
        while left := self.left(bench.world, cast):
            # One that failed waits until others are out of its way.
            name = min(left, key=lambda one: tries.get(one, 0))
            if tries.get(name, 0) == _TRIES:
                _LOG.warning("the expert leaves the %s where it is: %s", name, said)
                return
            number = tries[name] = tries.get(name, 0) + 1
            try:
                yield from self._bring(bench, cast, name, number)
            except SkillFailedError as error:
                said = str(error)
                if holder_of(bench, name) is not None:
                    yield from PutAside(thing=name).run(bench, cast, ())
                yield from recover(bench)

    def left(self, world: World, cast: Cast) -> list[str]:
        """What is not yet where it belongs, the uppermost first."""
        found = [
            name for name in cast.of(self.things) if world.share_inside(name, self.into[cast.kinds[name]]) < _INSIDE
        ]
        return sorted(found, key=lambda name: -float(world.bounds(name)[1][2]))

    def _bring(self, bench: Bench, cast: Cast, name: str, number: int) -> Iterator[Segment]:
        """By the arm that reaches both; at the second time to where there is room, to be taken from there another way;
        at the third by the other one's hand.
        """
        pick, put = Pick(thing=name, lift=_LIFT), Insert(thing=name, into=self.into[cast.kinds[name]])
        give, aside = Handover(thing=name, height=_MEETING), PutAside(thing=name)
        if number == _ASIDE:
            yield from pick.run(bench, cast, (aside,))
            yield from aside.run(bench, cast, ())
            yield from pick.run(bench, cast, (put,))
        elif number == _HANDED:
            yield from pick.run(bench, cast, (give, put))
            yield from give.run(bench, cast, (put,))
        else:
            yield from pick.run(bench, cast, (put,))
        yield from put.run(bench, cast, ())
