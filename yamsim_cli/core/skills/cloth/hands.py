"""Hands on cloth: they take it at points, bring these elsewhere on an arch, and let go; and what would come of that."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np

from ...geometry.se3 import Array, interpolate_rotation, pose
from ...sim.cloth import between_pads, pulled
from ...types import Cause
from ..bench import Bench, Fingers, Segment, SkillFailedError
from ..hand import Hand
from ..moves import GRIP_TICKS, idle, rest
from .reach import APPROACH, TIPS, WIDE, Taken, clear_of

# Fingers press on cloth so hard, N.
_FORCE = 20.0

# Where it was not there, they feel for it so much lower, m, with fingers that open for so many ticks before.
_STEP = 0.002
_DEEPER = (_STEP, 2 * _STEP, 3 * _STEP, 4 * _STEP)
_OPEN_TICKS = 4

# Fingers that were told to open by `WIDE` each are stuck if they are open more than this, m.
_STUCK = 2 * WIDE

# Fingers are closed that are open less than this each, m: far less than they open before, and more than cloth is thick.
_SHUT = 0.006

# A hand that let go is under what it laid, and leaves it by so much, m.
_OUT = 0.04

#: A fold goes on an arch so high, as a share of its way.
ARCH = 0.45

#: Of a hand with cloth, m/s.
SPEED = 0.12
# So much over where it lies it is let go of, m.
_OVER = 0.002
# What is pulled comes up by so much on its way, m: tips that rub on the table hold arms back by 2 to 4 cm.
_LOW = 0.006


def outcome(bench: Bench, thing: str, taken: Sequence[Taken], arch: float = ARCH, speed: float = SPEED) -> Array:
    """Where a cloth's points (along y, along x, 3) would be if hands took it and brought it elsewhere, m; see `carry`.

    Tried in a simulation beside the real one, in which no hand moves, but what hands would take of it.
    """
    cloth, points = bench.world.cloth(thing), bench.world.points(thing)
    patches = []
    for one in taken:
        row, column = one.lay.point
        between = between_pads(cloth, points.reshape(-1, 3), one.T_at)
        patches.append(np.union1d(between, [row * points.shape[1] + column]))
    ways = [one.lay.where(points) - points[one.lay.point] for one in taken]
    seconds = max(float(np.linalg.norm(way[:2])) for way in ways) / speed
    return pulled(bench.world.data, bench.model, cloth, patches, ways, arch, seconds)


def carry(
    bench: Bench, thing: str, taken: Sequence[Taken], arch: float = ARCH, speed: float = SPEED
) -> Iterator[Segment]:
    """Take points of a cloth, bring them where they are to lie, and let go.

    Args:
        arch: how high they are lifted on their way, as a share of it.
        speed: m/s.

    Raises:
        SkillFailedError: a hand missed its point, or its fingers do not close.
    """
    wide = {one.hand: Fingers(WIDE) for one in taken}
    yield from _approached(bench, taken)
    _check_fingers(bench, taken)
    yield bench.segment({one.hand: bench.line(one.hand, one.T_at) for one in taken})
    yield from _take(bench, thing, taken)
    missed = [one.hand for one in taken if one.hand.side not in bench.world.holders(thing)]
    if not missed:
        yield bench.segment(_arches(bench, thing, taken, arch, speed))
        yield rest(bench)
    yield bench.segment({hand: bench.still(hand, GRIP_TICKS) for hand in wide}, wide, arrives=False)
    # Hands that pulled a layer alone are on it, but for fingers that came to be under its edge.
    lifters = bench.world.lifters(thing)
    under = [] if missed else [one for one in taken if not one.lay.alone or one.hand.side in lifters]
    if under:
        yield bench.segment({one.hand: _withdrawn(bench, one) for one in under}, arrives=False)
    up = {}
    for hand in wide:
        T_up = hand.pinch_at(hand.joints)
        T_up[2, 3] += APPROACH
        up[hand] = bench.line(hand, T_up)
    yield bench.segment(up, arrives=False)
    if missed:
        sides = " and the ".join(sorted(hand.side for hand in missed))
        raise SkillFailedError(Cause.SLIPPED, f"the {sides} hand missed its corner of the {thing}")


def _approached(bench: Bench, taken: Sequence[Taken]) -> Iterator[Segment]:
    """Bring hands to before their points, and those that have none out of the way: at once, where their ways are free
    of each other.
    """
    wide = {one.hand: Fingers(WIDE) for one in taken}
    goals = {hand: hand.ready for hand in idle(bench) if hand not in wide}
    goals |= {one.hand: one.before for one in taken}
    ways = {hand: bench.free_path(hand, goal, WIDE) for hand, goal in goals.items()}
    if _free_together(bench, ways):
        yield bench.segment(ways, wide, arrives=False)
        return
    for hand, goal in goals.items():
        fingers = {hand: wide[hand]} if hand in wide else {}
        yield bench.segment({hand: bench.free_path(hand, goal, WIDE)}, fingers, arrives=False)


def _check_fingers(bench: Bench, taken: Sequence[Taken]) -> None:
    """Raise `SkillFailedError` where fingers did not come nearer to each other: so far open they would go through cloth
    that stands up beside a point, and take it along.
    """
    for one in taken:
        if bench.opening(one.hand) > _STUCK:
            raise SkillFailedError(Cause.SLIPPED, f"the {one.hand.side} hand's fingers do not close")


def _free_together(bench: Bench, ways: Mapping[Hand, Array]) -> bool:
    """Whether hands that go their ways (n + 1, dof) at once do not touch each other."""
    ticks = max(len(way) for way in ways.values())
    for tick in range(ticks):
        there = [(hand, way[min(tick, len(way) - 1)]) for hand, way in ways.items()]
        if not all(clear_of(bench, one, other) for one, other in itertools.combinations(there, 2)):
            return False
    return True


def _take(bench: Bench, thing: str, taken: Sequence[Taken]) -> Iterator[Segment]:
    """Close hands on their points. They feel for these where nothing was between their fingers: an arm comes to rest a
    little too high, and what lies hollow gives way to fingers that come down.
    """
    yield from _close(bench, taken)
    points = bench.world.points(thing)
    room = {one.hand: _room(points, one) for one in taken}
    for deeper in _DEEPER:
        holders = bench.world.holders(thing)
        felt = [
            one
            for one in taken
            if one.hand.side not in holders and deeper - _STEP < room[one.hand] and _closed(bench, one.hand)
        ]
        if not felt:
            return
        opened = {one.hand: Fingers(WIDE) for one in felt}
        yield bench.segment({hand: bench.still(hand, _OPEN_TICKS) for hand in opened}, opened)
        lines = {}
        for one in felt:
            lower = one.T_at.copy()
            lower[2, 3] -= min(deeper, room[one.hand])
            lines[one.hand] = bench.line(one.hand, lower)
        yield bench.segment(lines)
        yield from _close(bench, felt)


def _room(points: Array, one: Taken) -> float:
    """How much lower a hand at its point may feel, m: its tips do not go into what the cloth (along y, along x, 3) lies
    on.
    """
    hollow = float(points[one.lay.point][2] - points[..., 2].min()) if one.lay.alone else 0.0
    return hollow + TIPS


def _close(bench: Bench, taken: Sequence[Taken]) -> Iterator[Segment]:
    """Close hands on what is between their fingers."""
    closing = {one.hand: Fingers(0.0, _FORCE) for one in taken}
    yield bench.segment({hand: bench.still(hand, GRIP_TICKS) for hand in closing}, closing)
    yield rest(bench)


def _closed(bench: Bench, hand: Hand) -> bool:
    """Whether fingers that were told to close did: others press cloth down that they do not take."""
    return bench.opening(hand) < _SHUT


def _withdrawn(bench: Bench, one: Taken) -> Array:
    """A hand's motion (n + 1, dof) out from under what it laid: outwards or aside; none where it reaches neither."""
    for outwards in (one.aside, one.outwards):
        T = one.hand.pinch_at(one.hand.joints)
        T[:2, 3] += _OUT * outwards
        T[2, 3] += _OUT / 4
        try:
            return bench.line(one.hand, T)
        except SkillFailedError:
            continue
    return bench.still(one.hand, 1)


def _arches(bench: Bench, thing: str, taken: Sequence[Taken], arch: float, speed: float) -> dict[Hand, Array]:
    """Every hand's motion (n + 1, dof) with its point, from where that is now to where it is to lie."""
    points = bench.world.points(thing)
    low, high = bench.world.block(thing)
    ends = {}
    for one in taken:
        T_now, point = one.hand.pinch_at(one.hand.joints), points[one.lay.point]
        in_pinch = T_now[:3, :3].T @ (point - T_now[:3, 3])
        # What is folded comes down from over all that lies there; what is pulled alone stays low.
        over = np.array([0.0, 0.0, _LOW if one.lay.alone else high[2] - low[2] + _OVER])
        ends[one.hand] = T_now, pose(one.lay.where(points) + over - one.R_end @ in_pinch, one.R_end)
    length = max(float(np.linalg.norm((T_end - T_now)[:2, 3])) for T_now, T_end in ends.values())
    return {
        hand: bench.curve(hand, partial(_arch, *both, arch * length), length / speed) for hand, both in ends.items()
    }


def _arch(T_start: Array, T_end: Array, height: float, share: float) -> Array:
    """A frame (4, 4) on its way over an arch so high, m."""
    way, across = T_end[:3, 3] - T_start[:3, 3], (1 - math.cos(math.pi * share)) / 2
    up = way[2] * share + height * math.sin(math.pi * share)
    R = interpolate_rotation(T_start[:3, :3], T_end[:3, :3], across)
    return pose(T_start[:3, 3] + [*(way[:2] * across), up], R)
