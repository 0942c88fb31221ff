"""Sort what lies about into the compartments for it, what lies on others first, in the order in which it turns out to go."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import ClassVar

import numpy as np

from ..core.geometry.se3 import Array, pose, rotation_z
from ..core.goals.cast import Cast
from ..core.goals.world import World
from ..core.skills.base import Skill, holder_of
from ..core.skills.bench import Bench, Segment
from ..core.skills.errors import SkillFailedError
from ..core.skills.hand import PASSING, Hand
from ..core.skills.handover import Handover
from ..core.skills.moves import let_go, recover
from ..core.skills.pick import Pick
from ..core.skills.place import OVER, Placing, raised
from ..core.skills.put_aside import PutAside
from ..core.tasks.casting import gap, outline
from .slide import Slide

_LOG = logging.getLogger("yamsim")

# So much of a thing's volume is to be in its compartment, from 0 to 1: a little more than the benchmark asks.
_INSIDE = 0.85
# How often each thing is tried, and at which time it is slid away from what it lies beside first, or handed over.
_TRIES, _SLID, _HANDED = 4, 2, 3
# What lies outside the tray waits for so many tries of what lies in it; and an arm this near to where it waits is out of
# the other one's way, rad.
_OUTSIDE, _PARKED = 1.5, 1e-6
# So high cutlery clears the tray's wall, also as it hangs in the fingers, m; and hands meet so high over the table.
_LIFT, _MEETING = 0.06, 0.25

# How finely places in a compartment are tried, m. A place that is lower by so much is the better one; and one that has
# so much room to all else is better than any other.
_GRID, _LOWER, _FREE = 0.02, 0.001, 0.003
# So many of either are offered.
_MOST = 12
# A thing whose z axis points up less than the first one of these, as sines, may stay as it is; and less than the second
# one, lies on its side or on its head.
_UPRIGHT, _HANGING = 0.95, 0.6


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
        while left := self.left(bench.world, cast):
            # One that failed waits until others are out of its way: those in the tray, and then all others.
            name = min(left, key=lambda one: tries.get(one, 0) + (0.0 if self._inside(bench.world, one) else _OUTSIDE))
            if tries.get(name, 0) == _TRIES:
                _LOG.warning("the expert leaves the %s where it is: %s", name, said[name])
                return
            parked = all(np.abs(hand.joints - hand.ready).max() < _PARKED for hand in bench.hands)
            try:
                yield from self._bring(bench, cast, name, tries.get(name, 0) + 1)
            except SkillFailedError as error:
                said[name] = str(error)
                yield from _put_back(bench, cast, name)
                yield from recover(bench)
                # An arm may have been in the other one's way, that now is out of it.
                tries[name] = tries.get(name, 0) + parked

    def _inside(self, world: World, name: str) -> bool:
        return any(world.share_inside(name, compartment) > 0.5 for compartment in self.into.values())

    def left(self, world: World, cast: Cast) -> list[str]:
        """What is not yet where it belongs: what lies on others first, then what lies in a compartment of others, and of
        these, one after the other from the left.
        """
        names = [
            name for name in cast.of(self.things) if world.share_inside(name, self.into[cast.kinds[name]]) < _INSIDE
        ]
        seen = {name: outline(world.block(name), world.pose(name)) for name in names}

        def order(name: str) -> tuple[int, bool, float]:
            above = sum(
                gap(seen[name], seen[other]) < 0 and world.pose(other)[2, 3] > world.pose(name)[2, 3]
                for other in names
                if other != name
            )
            return above, not self._inside(world, name), -float(world.pose(name)[1, 3])

        return sorted(names, key=order)

    def _put(self, cast: Cast, name: str) -> Lay:
        return Lay(thing=name, into=self.into[cast.kinds[name]], beside=self.things)

    def _bring(self, bench: Bench, cast: Cast, name: str, number: int) -> Iterator[Segment]:
        """By the arm that reaches both; at the second time to where there is room, to be taken from there another way;
        at the third by the other one's hand.
        """
        pick, put = Pick(thing=name, lift=_LIFT), self._put(cast, name)
        give = Handover(thing=name, height=_MEETING)
        if number == _SLID:
            yield from Slide(thing=name).run(bench, cast, (pick,))
            yield from pick.run(bench, cast, (put,))
        elif number >= _HANDED:
            yield from pick.run(bench, cast, (give, put))
            yield from give.run(bench, cast, (put,))
        else:
            yield from pick.run(bench, cast, (put,))
        yield from put.run(bench, cast, ())


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


class Lay(Placing):
    """Lay a long thing along a compartment, beside what lies there already if there is room, else on it.

    Attributes:
        thing: a role; it is in a hand.
        into: a compartment.
        beside: a role: what may lie there.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "into", "beside")
    LOWERING: ClassVar[float] = 0.25
    into: str
    beside: str

    def support(self, cast: Cast) -> str:
        """See `Placing`."""
        return cast.one(self.into)

    def goals(self, bench: Bench, cast: Cast, thing: str) -> list[Array]:
        """See `Placing`."""
        world, into = bench.world, cast.one(self.into)
        T, (low, high), block = world.pose(into), world.interior(into), world.block(thing)
        others = [outline(world.block(name), world.pose(name)) for name in cast.of(self.beside) if name != thing]
        free, taken = list[tuple[float, Array]](), list[tuple[float, Array]]()
        for R in _along(world, thing, T):
            corners = outline(block, pose(rotation=T[:3, :3].T @ R))
            first, last = low[:2] - corners.min(axis=0), high[:2] - corners.max(axis=0)
            if (first > last).any():
                continue
            for x in _spread(first[0], last[0]):
                for y in _spread(first[1], last[1]):
                    T_goal = pose((T @ (x, y, 0.0, 1.0))[:3], R)
                    off = math.hypot(*((x, y) - (first + last) / 2))
                    there = outline(block, T_goal)
                    (taken if any(gap(there, other) < _FREE for other in others) else free).append((off, T_goal))
        free = sorted(free, key=lambda each: each[0])
        free = free[:: math.ceil(len(free) / _MOST)] if free else []
        for _, T_goal in free[:1] + taken:
            T_goal[2, 3] = bench.height_of(thing, T_goal, into)
        for _, T_goal in free[1:]:
            T_goal[2, 3] = free[0][1][2, 3]
        taken.sort(key=lambda each: (round(each[1][2, 3] / _LOWER), each[0]))
        return [T_goal for _, T_goal in free + taken[:_MOST]]

    def _over(self, hand: Hand, T_pinch: Array) -> Array | None:
        """See `Placing`; else by way of the place itself, from where a pick has found this way."""
        joints = super()._over(hand, T_pinch)
        if joints is None and (there := hand.reach(T_pinch, (hand.joints, hand.ready), PASSING)) is not None:
            joints = hand.reach(raised(T_pinch, OVER), (there,), PASSING)
        return joints


def _along(world: World, thing: str, T: Array) -> list[Array]:
    """How a long thing may lie in a compartment at (4, 4): rotations (3, 3) in `world`, either way round. One that lies
    on its side, or on its head, stays so.
    """
    low, high = world.block(thing)
    now, longest = world.pose(thing)[:3, :3], int(np.argmax(high - low))
    wanted = math.atan2(T[1, 1], T[0, 1])
    lying = [np.eye(3)] if now[2, 2] > _UPRIGHT else [np.eye(3), now] if now[2, 2] > _HANGING else [now]
    return [
        rotation_z(wanted + turn - math.atan2(R[1, longest], R[0, longest])) @ R
        for R in lying
        for turn in (0.0, math.pi)
    ]


def _spread(first: float, last: float) -> Array:
    return np.linspace(first, last, max(1, math.ceil((last - first) / _GRID)) + 1)
