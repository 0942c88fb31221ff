"""Skills that sort cutlery into the compartments of a tray."""

from __future__ import annotations

import itertools
import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..core.config.goals.cast import Cast
from ..core.config.goals.world import TABLE
from ..core.expert.skills.base import Side, Skill, holder_of
from ..core.expert.skills.bench import Bench, Fingers, Segment, SkillFailedError
from ..core.expert.skills.hand import PASSING, Hand
from ..core.expert.skills.handover import Handover
from ..core.expert.skills.insert import Insert
from ..core.expert.skills.moves import let_go, park_free, recover, rest
from ..core.expert.skills.pick import Pick
from ..core.expert.skills.place import HOVER_HEIGHT, Placing, raised
from ..core.geometry.se3 import Array, pose, rotation_from_vector, rotation_z, yaw
from ..core.scene.casting import gap, outline
from ..core.sim.world import SimWorld
from ..core.types import Cause

_LOG = logging.getLogger("yamsim")

_INSIDE = 0.85  # share of a thing's volume in its compartment; the benchmark requires a little less
_TRIES = 4  # count, tries of each thing
_OUTSIDE = 1.5  # tries by which things outside the tray wait for those inside
_PARKED = 1e-6  # rad; an arm this near to its ready joints is out of the other arm's way
_LIFT = 0.06  # m, at which cutlery that hangs in the fingers clears the tray's wall
_MEETING = 0.25  # m over the table, where hands meet

_GRID = 0.02  # m, between the places that are tried in a compartment
_LOWER = 0.001  # m; a place that is lower by this is better
_FREE = 0.003  # m; a place with this room to all other things is preferred
_MAX_PLACES = 12  # that are offered, free and occupied ones each
_TABLE_GRID = 0.04  # m, between the places on the table that are tried
_MAX_ASIDE = 0.30  # m, of such a place from where the thing is
_ASIDE_GAP = 0.015  # m, between a thing on such a place and other things

_UPRIGHT = 0.95  # z of the z axis; a thing above stays upright
_HANGING = 0.6  # z of the z axis; a thing below stays on its side or on its head

_ROOM = 0.040  # m, that is searched on both sides of a thing, and the longest slide
_MIN_SLIDE = 0.005  # m
_MOVED = 0.002  # m, by which a thing must move to count as slid
_FLAT = 0.006  # m, of a thing's top above its lowest point, where closed fingers press; a higher part would roll
_SPACING = 0.012  # m, between places to press
_ABOVE = 0.07  # m, from where the hand comes down
_TOUCHING = 0.012  # m above the pressing pose, where contacts with other things are checked
_SLIDING = 0.10  # m/s, of a pressing hand
_SHORT = 0.006  # m, by which friction shortens a slide

_TILTS = tuple(math.radians(angle) for angle in (0, 20, -20, 35, -35))  # of the hand to the side
_LEANS = tuple(math.radians(angle) for angle in (0, 20, -20, 40, -40))  # of the hand along the thing


class PlaceInCompartment(Placing):
    """Place a long thing along a compartment, beside the things there if there is room, else on them.

    Attributes:
        thing: a role; it is in a hand.
        into: a compartment.
        beside: a role, of the things that may be in the compartment.
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
        T, (low, high), block = world.pose(into), world.block(into), world.block(thing)
        others = [outline(world.block(name), world.pose(name)) for name in cast.of(self.beside) if name != thing]
        free, occupied = list[tuple[float, Array]](), list[tuple[float, Array]]()
        for R in _along(world, thing, T):
            corners = outline(block, pose(rotation=T[:3, :3].T @ R))
            first, last = low[:2] - corners.min(axis=0), high[:2] - corners.max(axis=0)
            if (first > last).any():
                continue
            for x in _places_between(first[0], last[0]):
                for y in _places_between(first[1], last[1]):
                    T_goal = pose((T @ (x, y, 0.0, 1.0))[:3], R)
                    off = math.hypot(*((x, y) - (first + last) / 2))
                    there = outline(block, T_goal)
                    (occupied if any(gap(there, other) < _FREE for other in others) else free).append((off, T_goal))
        free = sorted(free, key=lambda each: each[0])
        free = free[:: math.ceil(len(free) / _MAX_PLACES)] if free else []
        for _, T_goal in free[:1] + occupied:
            T_goal[2, 3] = bench.height_of(thing, T_goal, into)
        for _, T_goal in free[1:]:
            T_goal[2, 3] = free[0][1][2, 3]
        occupied.sort(key=lambda each: (round(each[1][2, 3] / _LOWER), each[0]))
        return [T_goal for _, T_goal in free + occupied[:_MAX_PLACES]]

    def _over(self, hand: Hand, T_pinch: Array) -> Array | None:
        """See `Placing`; where that fails, from joints that reach the place itself."""
        joints = super()._over(hand, T_pinch)
        if joints is None and (there := hand.reach(T_pinch, (hand.joints, hand.ready), PASSING)) is not None:
            joints = hand.reach(raised(T_pinch, HOVER_HEIGHT), (there,), PASSING)
        return joints


def _along(world: SimWorld, thing: str, T: Array) -> list[Array]:
    """Rotations (3, 3) in `world` of a long thing along a compartment at pose (4, 4), in both directions.

    A thing on its side or on its head stays so.
    """
    low, high = world.block(thing)
    longest = int(np.argmax(high - low))
    wanted = math.atan2(T[1, 1], T[0, 1])
    return [
        rotation_z(wanted + turn - math.atan2(R[1, longest], R[0, longest])) @ R
        for R in _attitudes(world, thing)
        for turn in (0.0, math.pi)
    ]


def _attitudes(world: SimWorld, thing: str) -> list[Array]:
    """Rotations (3, 3), up to the heading, in which a thing may be put down; on its side or head it stays so."""
    now = world.pose(thing)[:3, :3]
    upright = rotation_z(yaw(world.pose(thing)))
    return [upright] if now[2, 2] > _UPRIGHT else [upright, now] if now[2, 2] > _HANGING else [now]


class PutBesideTray(Placing):
    """Put a long thing down on a free place of the table, the nearest first.

    Attributes:
        thing: a role; it is in a hand.
    """

    def goals(self, bench: Bench, cast: Cast, thing: str) -> list[Array]:
        """See `Placing`."""
        world, (low, high) = bench.world, bench.world.bounds(TABLE)
        others = [outline(world.block(name), world.pose(name)) for name in world.things if name != thing]
        block, now = world.block(thing), world.pose(thing)[:2, 3]
        turns = (0.0, math.pi / 2, math.pi, -math.pi / 2)
        rotations = [rotation_z(turn) @ R for R in _attitudes(world, thing) for turn in turns]
        found = list[tuple[float, Array]]()
        for x, y in itertools.product(*(np.arange(float(low[k]), float(high[k]), _TABLE_GRID) for k in (0, 1))):
            off = math.hypot(x - now[0], y - now[1])
            if off > _MAX_ASIDE:
                continue
            for R in rotations:
                T = pose((x, y, 0.0), R)
                there = outline(block, T)
                on_table = (there >= low[:2]).all() and (there <= high[:2]).all()
                if on_table and all(gap(there, other) >= _ASIDE_GAP for other in others):
                    found.append((off, T))
        goals = [T for _, T in sorted(found, key=lambda each: each[0])]
        height = bench.height_of(thing, goals[0], TABLE) if goals else 0.0
        for T in goals:
            T[2, 3] = height
        return goals


def _places_between(first: float, last: float) -> Array:
    return np.linspace(first, last, max(1, math.ceil((last - first) / _GRID)) + 1)


@dataclass(frozen=True)
class _Press:
    """Where a hand presses: joints (dof,) above the place, and poses (4, 4) of the pinch frame above and pressing."""

    above: Array
    T_above: Array
    T_press: Array


class Slide(Skill):
    """Press closed fingers onto a flat thing, and slide it sideways to the middle of its room.

    Attributes:
        thing: a role.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    NEEDS_HELD: ClassVar[bool | None] = False
    thing: str
    arm: Side = "any"

    def run(self, bench: Bench, cast: Cast, ahead: Sequence[Skill]) -> Iterator[Segment]:
        """See `Skill`."""
        thing = cast.one(self.thing)
        across = _across(bench, thing)
        one, other = (bench.obstacles.room(bench.qpos, thing, side * across, _ROOM) for side in (1.0, -1.0))
        distance = (one - other) / 2
        if abs(distance) < _MIN_SLIDE:
            raise SkillFailedError(Cause.UNREACHABLE, f"the {thing} has no more room on one side than on the other")
        shift = distance * across
        before = bench.world.pose(thing)[:2, 3].copy()
        hands = bench.free_hands(self.arm)
        for hand in sorted(hands, key=lambda hand: float(np.linalg.norm(hand.arm.T_base_in_world[:2, 3] - before))):
            for press in self._presses(bench, hand, thing, shift):
                yield from park_free(bench, hand)
                yield from _slid(bench, hand, press, shift)
                moved = float((bench.world.pose(thing)[:2, 3] - before) @ shift) / abs(distance)
                if moved < _MOVED:
                    raise SkillFailedError(Cause.OFF_TARGET, f"the {thing} did not slide")
                return
        raise SkillFailedError(Cause.UNREACHABLE, f"no arm reaches a place where it could press on the {thing}")

    def _presses(self, bench: Bench, hand: Hand, thing: str, shift: Array) -> Iterator[_Press]:
        """The presses with which a hand can slide a thing without touching another one."""
        away = shift / np.linalg.norm(shift)
        down = np.array((0.0, 0.0, -1.0))
        upright = np.column_stack([np.cross((*away, 0.0), down), (*away, 0.0), down])
        far = np.array((*(shift + _SHORT * away), 0.0))
        places = _flat_places(bench, thing, away)
        for tilt, lean, place, turn in itertools.product(_TILTS, _LEANS, places, (0.0, math.pi)):
            turned = rotation_from_vector([tilt, 0.0, 0.0]) @ rotation_from_vector([0.0, lean, 0.0])
            R = upright @ turned @ rotation_from_vector([0.0, 0.0, turn])
            T_press = pose(place, R)
            T_touching, T_above, T_end = (T_press.copy() for _ in range(3))
            T_touching[2, 3] += _TOUCHING
            T_above[2, 3] += _ABOVE
            T_end[:3, 3] += far
            above = hand.reach(T_above, (hand.joints, hand.ready), PASSING)
            if above is None or bench.touched(hand, above, 0.0):
                continue
            touching = hand.reach(T_touching, (above,), PASSING)
            if touching is None or bench.touched(hand, touching, 0.0, between=thing):
                continue
            T_touching[:3, 3] += far
            end = hand.reach(T_touching, (touching,), PASSING)
            if end is None or bench.touched(hand, end, 0.0, between=thing):
                continue
            yield _Press(above, T_above, T_press)


def _slid(bench: Bench, hand: Hand, press: _Press, shift: Array) -> Iterator[Segment]:
    """Approach, press, slide, and retreat."""
    closed = {hand: Fingers(0.0)}
    yield bench.segment({hand: bench.free_path(hand, press.above)}, closed, arrives=False)
    yield bench.segment({hand: bench.line(hand, press.T_press)})
    T_end = press.T_press.copy()
    T_end[:2, 3] += shift * (1.0 + _SHORT / float(np.linalg.norm(shift)))
    yield bench.segment({hand: bench.line(hand, T_end, _SLIDING)})
    T_up = T_end.copy()
    T_up[2, 3] = press.T_above[2, 3]
    yield bench.segment({hand: bench.line(hand, T_up)}, arrives=False)
    yield rest(bench)


def _across(bench: Bench, thing: str) -> Array:
    """The horizontal direction (2,) in `world` at right angles to a thing's longest side."""
    low, high = bench.world.block(thing)
    longest = bench.world.pose(thing)[:2, int(np.argmax(high - low))]
    across: Array = np.array((-longest[1], longest[0])) / np.linalg.norm(longest)
    return across


def _flat_places(bench: Bench, thing: str, away: Array) -> list[Array]:
    """Places (3,) on top of a thing's flat parts, in `world`, m: the farthest in the direction of the slide first."""
    bounds = bench.world.parts(thing)
    lowest, middle = bench.world.bounds(thing)[0][2], bench.world.pose(thing)[:2, 3]
    low = [(*(first + last)[:2] / 2, last[2]) for first, last in bounds if last[2] < lowest + _FLAT]
    found: list[Array] = []
    for place in sorted(map(np.array, low), key=lambda place: -float((place[:2] - middle) @ away)):
        if all(np.linalg.norm(place - other) > _SPACING for other in found):
            found.append(place)
    return found


class Sort(Skill):
    """Put each thing into the compartment of its kind. Things that are there already stay.

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
        failures: dict[str, str] = {}
        # Things that have to leave one compartment for another take more tries, and the time is short.
        hasty = any(self._in_tray(bench.world, name) for name in self.left(bench.world, cast, False))
        bring = self._hastily if hasty else self._calmly

        def waits(name: str) -> float:
            """A thing's place in the queue: after its failures, other things are tried first."""
            return tries.get(name, 0) + (_OUTSIDE if hasty and not self._in_tray(bench.world, name) else 0.0)

        while left := self.left(bench.world, cast, hasty):
            name = min(left, key=waits)
            if tries.get(name, 0) == _TRIES:
                _LOG.warning("the expert leaves the %s where it is: %s", name, failures[name])
                return
            parked = all(np.abs(hand.joints - hand.ready).max() < _PARKED for hand in bench.hands)
            try:
                yield from bring(bench, cast, name, tries.get(name, 0) + 1)
            except SkillFailedError as error:
                failures[name] = str(error)
                yield from _put_back(bench, cast, name)
                yield from recover(bench)
                # A try counts only if both arms were parked: otherwise one may have blocked the other.
                tries[name] = tries.get(name, 0) + parked

    def _in_tray(self, world: SimWorld, name: str) -> bool:
        return any(world.share_inside(name, compartment) > 0.5 for compartment in self.into.values())

    def left(self, world: SimWorld, cast: Cast, hasty: bool) -> list[str]:
        """The things that are not in their compartment: the uppermost first; in haste, those in the tray first."""
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
        """By the arm that reaches both; on the second try displaced first; on later tries by a handover."""
        pick, put = Pick(thing=name, lift=_LIFT), Insert(thing=name, into=self.into[cast.kinds[name]])
        if number == 2:
            yield from _displaced(bench, cast, name, pick)
        yield from _brought(bench, cast, name, pick, put, handed=number > 2)

    def _hastily(self, bench: Bench, cast: Cast, name: str, number: int) -> Iterator[Segment]:
        """By the arm that reaches both; on the second try slid free first, on the third displaced; then handed over."""
        pick = Grab(thing=name, lift=_LIFT)
        put = PlaceInCompartment(thing=name, into=self.into[cast.kinds[name]], beside=self.things)
        if number == 2:
            with suppress(SkillFailedError):
                yield from Slide(thing=name).run(bench, cast, (pick,))
        if number == 3:
            yield from _displaced(bench, cast, name, pick)
        yield from _brought(bench, cast, name, pick, put, handed=number > 3)


def _displaced(bench: Bench, cast: Cast, name: str, pick: Pick) -> Iterator[Segment]:
    """Put a thing down elsewhere, where other grips are free."""
    put_aside = PutBesideTray(thing=name)
    yield from pick.run(bench, cast, (put_aside,))
    yield from put_aside.run(bench, cast, ())


def _brought(bench: Bench, cast: Cast, name: str, pick: Pick, put: Skill, handed: bool) -> Iterator[Segment]:
    """Pick a thing up and put it down, with or without a handover between."""
    give = Handover(thing=name, height=_MEETING)
    between = (give,) if handed else ()
    yield from pick.run(bench, cast, (*between, put))
    if handed:
        yield from give.run(bench, cast, (put,))
    yield from put.run(bench, cast, ())


class Grab(Pick):
    """Grasp a narrow thing: the arm need not be at rest before the fingers close."""

    WAITS: ClassVar[bool] = False


def _put_back(bench: Bench, cast: Cast, name: str) -> Iterator[Segment]:
    """Release a held thing: where there is room, else where it hangs, a little lower."""
    hand = holder_of(bench, name)
    if hand is None:
        return
    try:
        yield from PutBesideTray(thing=name).run(bench, cast, ())
    except SkillFailedError:
        T = hand.pinch_at(hand.joints)
        T[2, 3] -= _LIFT
        with suppress(SkillFailedError):
            yield bench.segment({hand: bench.line(hand, T)})
        yield from let_go(bench, hand, bench.clearance(name))
