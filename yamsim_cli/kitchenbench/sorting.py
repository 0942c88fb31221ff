"""Sort what lies about into the compartments for it, in the order in which it turns out to go."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import ClassVar

import numpy as np

from ..core.goals.cast import Cast
from ..core.sim.world import SimWorld
from ..core.skills.base import Skill, holder_of
from ..core.skills.bench import Bench, Segment
from ..core.skills.errors import SkillFailedError
from ..core.skills.handover import Handover
from ..core.skills.insert import Insert
from ..core.skills.moves import let_go, recover
from ..core.skills.pick import Pick
from ..core.skills.put_aside import PutAside
from ..core.tasks.casting import gap, outline
from .lay import Lay
from .slide import Slide

_LOG = logging.getLogger("yamsim")

# So much of a thing's volume is to be in its compartment, from 0 to 1: a little more than the benchmark asks.
_INSIDE = 0.85
# How often each thing is tried, and at which time it is put or slid aside first, or handed over.
_TRIES, _ASIDE, _HANDED = 4, 2, 3
# What lies outside the tray waits for so many tries of what lies in it. An arm that is so near to where it waits is out
# of the other one's way, rad.
_OUTSIDE, _PARKED = 1.5, 1e-6
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
        said: dict[str, str] = {}
        # Pieces that have to leave one cell of the tray for another take more tries, and leave no time to lose.
        hasty = any(self._in_tray(bench.world, name) for name in self.left(bench.world, cast, False))
        bring = self._hastily if hasty else self._calmly

        def waits(name: str) -> float:
            """One that failed waits until others are out of its way: those in the tray, and then all others."""
            return tries.get(name, 0) + (_OUTSIDE if hasty and not self._in_tray(bench.world, name) else 0.0)

        while left := self.left(bench.world, cast, hasty):
            name = min(left, key=waits)
            if tries.get(name, 0) == _TRIES:
                _LOG.warning("the expert leaves the %s where it is: %s", name, said[name])
                return
            parked = all(np.abs(hand.joints - hand.ready).max() < _PARKED for hand in bench.hands)
            try:
                yield from bring(bench, cast, name, tries.get(name, 0) + 1)
            except SkillFailedError as error:
                said[name] = str(error)
                yield from _put_back(bench, cast, name)
                yield from recover(bench)
                # An arm may have been in the other one's way, that now is out of it.
                tries[name] = tries.get(name, 0) + parked

    def _in_tray(self, world: SimWorld, name: str) -> bool:
        return any(world.share_inside(name, compartment) > 0.5 for compartment in self.into.values())

    def left(self, world: SimWorld, cast: Cast, hasty: bool) -> list[str]:
        """What is not yet where it belongs: the uppermost first; in haste, what lies in the tray before all else."""
        names = [
            name for name in cast.of(self.things) if world.share_inside(name, self.into[cast.kinds[name]]) < _INSIDE
        ]
        if not hasty:
            return sorted(names, key=lambda name: -float(world.bounds(name)[1][2]))
        seen = {name: outline(world.block(name), world.pose(name)) for name in names}

        def order(name: str) -> tuple[int, bool, float]:
            above = sum(
                gap(seen[name], seen[other]) < 0 and world.pose(other)[2, 3] > world.pose(name)[2, 3]
                for other in names
                if other != name
            )
            return above, not self._in_tray(world, name), -float(world.pose(name)[1, 3])

        return sorted(names, key=order)

    def _calmly(self, bench: Bench, cast: Cast, name: str, number: int) -> Iterator[Segment]:
        """By the arm that reaches both; at the second time to where there is room, to be taken from there another way;
        after that by way of the other hand.
        """
        pick, put = Pick(thing=name, lift=_LIFT), Insert(thing=name, into=self.into[cast.kinds[name]])
        if number == _ASIDE:
            aside = PutAside(thing=name)
            yield from pick.run(bench, cast, (aside,))
            yield from aside.run(bench, cast, ())
        if number >= _HANDED:
            yield from _handed(bench, cast, name, pick, put)
        else:
            yield from pick.run(bench, cast, (put,))
        yield from put.run(bench, cast, ())

    def _hastily(self, bench: Bench, cast: Cast, name: str, number: int) -> Iterator[Segment]:
        """By the arm that reaches both; at the second time slid free first; after that by way of the other hand."""
        pick = Grab(thing=name, lift=_LIFT)
        put = Lay(thing=name, into=self.into[cast.kinds[name]], beside=self.things)
        if number == _ASIDE:
            with suppress(SkillFailedError):
                yield from Slide(thing=name).run(bench, cast, (pick,))
        if number >= _HANDED:
            yield from _handed(bench, cast, name, pick, put)
        else:
            yield from pick.run(bench, cast, (put,))
        yield from put.run(bench, cast, ())


def _handed(bench: Bench, cast: Cast, name: str, pick: Pick, put: Skill) -> Iterator[Segment]:
    give = Handover(thing=name, height=_MEETING)
    yield from pick.run(bench, cast, (give, put))
    yield from give.run(bench, cast, (put,))


class Grab(Pick):
    """Take something narrow: the arm arrives before the fingers have met it."""

    WAITS: ClassVar[bool] = False


def _put_back(bench: Bench, cast: Cast, name: str) -> Iterator[Segment]:
    """Free the hand of a thing, if one holds it: where there is room, else where it hangs, after a little way down."""
    hand = holder_of(bench, name)
    if hand is None:
        return
    try:
        yield from PutAside(thing=name).run(bench, cast, ())
    except SkillFailedError:
        T = hand.pinch_at(hand.joints)
        T[2, 3] -= _LIFT
        with suppress(SkillFailedError):
            yield bench.segment({hand: bench.line(hand, T)})
        yield from let_go(bench, hand, bench.clearance(name))
