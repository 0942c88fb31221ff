"""Hands on cloth: they take it at points, bring these elsewhere on an arch, and let go."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..geometry.se3 import Array, interpolate_rotation, pose, rotation_from_vector, rotation_z
from ..types import Cause
from .bench import Bench, Fingers, Segment
from .errors import SkillFailedError
from .hand import PASSING, Hand
from .moves import GRIP_TICKS, rest

# Fingers open so far each before they close on cloth, and press so hard, m and N.
_WIDE = 0.012
_FORCE = 20.0

# The pinch frame is so high over a point that is taken: half a pad, and what lets the tips press on the cloth and stay
# off what it lies on, m. And so far inwards, so that both pads come down on cloth.
_HALF_PAD, _HALF_WIDTH, _TIPS = 0.0082, 0.0072, 0.001
_INWARDS = 0.007

# Of a layer that lies on others, a hand takes hold beside a point on the side of points up to so many cells away.
_NEXT = 2

# Where it was not there, they feel for it so much lower, m, with fingers that open for so many ticks before.
_DEEPER = (0.002, 0.004, 0.006, 0.008)
_OPEN_TICKS = 4

# What is so near, seen from above, lies on each other, m.
_THERE = 0.012

# A hand that let go is under what it laid, and leaves it by so much, m.
_OUT = 0.04

# From so far a hand comes, and there it looks whether it touches anything; m.
_APPROACH = 0.08
_NEAR = 0.03

#: A fold goes on an arch so high, as a share of its way.
ARCH = 0.45

#: Of a hand with cloth, m/s.
SPEED = 0.12
# So much over where it lies it is let go of, m.
_OVER = 0.002

# How far a hand may lean back to its arm, rad.
_LEANS = tuple(math.radians(angle) for angle in (0, 15, 30, 45))

#: Where a point of cloth is laid (3,), in `world`, m: of where its points (along y, along x, 3) are when a hand has it.
Where = Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class Lay:
    """A point of cloth that is taken, and where it is laid.

    Attributes:
        point: its row and column.
        where: see `Where`.
        alone: whether it is taken without the layers below it.
    """

    point: tuple[int, int]
    where: Where
    alone: bool = False


@dataclass(frozen=True, eq=False)
class Taken:
    """A hand at a point: its pinch frame (4, 4) there, how that is turned where it ends (3, 3), and its joints (dof,)
    before the point and over the end; and which ways (2,) lead out from under the cloth there: ahead, and aside.
    """

    hand: Hand
    lay: Lay
    T_at: Array
    R_end: Array
    before: Array
    end: Array
    outwards: Array
    aside: Array


def at(place: Array) -> Where:
    """At a place (3,), wherever the cloth is then."""
    return lambda points: place


def onto(point: tuple[int, int]) -> Where:
    """Onto another point."""
    return lambda points: points[point]


def reached(bench: Bench, thing: str, lays: Sequence[Lay]) -> list[Taken] | None:
    """How free hands take points of a cloth, each its own; None if they do not reach these, or where they are laid."""
    points = bench.world.points(thing)
    free = [hand for hand in bench.hands if hand.held is None]
    for hands in itertools.permutations(free, len(lays)):
        # Arms do not cross: the farther to the left a hand's arm stands, the farther to the left is its point.
        sides = [hand.arm.T_base_in_world[1, 3] for hand in hands]
        places = [points[lay.point][1] for lay in lays]
        if len(lays) > 1 and (sides[0] - sides[1]) * (places[0] - places[1]) <= 0:
            continue
        taken: list[Taken] = []
        for hand, lay in zip(hands, lays, strict=True):
            if (one := _taken(bench, hand, points, lay)) is None:
                break
            taken.append(one)
        if len(taken) == len(lays) and _apart(bench, taken):
            return taken
    return None


def _taken(bench: Bench, hand: Hand, points: Array, lay: Lay) -> Taken | None:
    """A hand at a point, leaning towards its arm as little as it reaches so, there and where it ends; None where it
    does not reach either.
    """
    place = points[lay.point]
    way = lay.where(points) - place
    middle = place[:2] + way[:2] / 2
    away = middle - hand.arm.T_base_in_world[:2, 3]
    heading = math.atan2(away[1], away[0])
    inwards = _inwards(place, _around(points, lay.point) if lay.alone else points.reshape(-1, 3))
    ahead = way[:2] / max(float(np.linalg.norm(way[:2])), 1e-9)
    aside = -inwards if lay.alone else (inwards @ ahead) * ahead - inwards
    # Fingers down and closing across the way from the arm, so that both tips are as high however the hand leans.
    level = rotation_z(heading + math.pi) @ np.diag([1.0, -1.0, -1.0])
    turns = [
        rotation_from_vector((lean * math.sin(heading), -lean * math.cos(heading), 0.0)) @ level for lean in _LEANS
    ]
    for lean, R in zip(_LEANS, turns, strict=True):
        up = _HALF_PAD * math.cos(lean) + _HALF_WIDTH * math.sin(lean) + _TIPS
        up -= 0.0 if lay.alone else _layers(points, place)
        T_at = pose((*(place[:2] + _INWARDS * inwards), place[2] + up), R)
        T_near = T_at.copy()
        T_near[2, 3] += _NEAR
        near = hand.reach(T_near, (hand.ready,), PASSING)
        at = None if near is None else hand.reach(T_at, (near,))
        if near is None or at is None or bench.obstacles.meets_itself(hand.number, at):
            continue
        before = hand.reach(T_at @ pose((0.0, 0.0, -_APPROACH)), (near,), PASSING)
        if before is None or bench.touched(hand, near, _WIDE) or bench.touched(hand, before, _WIDE):
            continue
        for R_end in (R, *(turn for turn in turns if turn is not R)):
            end = hand.reach(pose(T_near[:3, 3] + [*way[:2], 0.0], R_end), (near,), PASSING)
            if end is not None and not bench.obstacles.meets_itself(hand.number, end):
                return Taken(hand, lay, T_at, R_end, before, end, ahead, aside)
    return None


def _layers(points: Array, place: Array) -> float:
    """How much higher a place (3,) on a cloth is than the lowest point of it there, m."""
    flat = points.reshape(-1, 3)
    there = np.linalg.norm(flat[:, :2] - place[:2], axis=1) < _THERE
    return float(place[2] - flat[there, 2].min())


def between_pads(points: Array, point: tuple[int, int], spacing: float) -> NDArray[np.int_]:
    """The numbers (n,) of a cloth's points that a hand takes hold of which takes a point alone, about.

    Args:
        points: of the cloth (along y, along x, 3), m.
        spacing: between neighbours, m.
    """
    place = points[point]
    middle = place[:2] + _INWARDS * _inwards(place, _around(points, point))
    off = points.reshape(-1, 3) - [*middle, place[2]]
    held = (np.abs(off[:, :2]) < max(_HALF_WIDTH, spacing / 2)).all(axis=1) & (np.abs(off[:, 2]) < _HALF_PAD)
    held[point[0] * points.shape[1] + point[1]] = True
    return np.flatnonzero(held)


def _inwards(place: Array, others: Array) -> Array:
    """Which way (2,) the middle of points (n, 3) lies from a place (3,), seen from above."""
    inwards: Array = others.mean(axis=0)[:2] - place[:2]
    inwards /= np.linalg.norm(inwards)
    return inwards


def _around(points: Array, point: tuple[int, int]) -> Array:
    """The points (n, 3) of a cloth that are next to a point in its grid, up to so many cells away."""
    row, column = point
    near = points[max(0, row - _NEXT) : row + _NEXT + 1, max(0, column - _NEXT) : column + _NEXT + 1]
    return near.reshape(-1, 3)


def _apart(bench: Bench, taken: Sequence[Taken]) -> bool:
    """Whether two hands that come to their points at once, and end at once, do not touch each other."""
    if len(taken) < 2:
        return True
    one, other = taken
    for mine, theirs in ((one.before, other.before), (one.end, other.end)):
        there = bench.imagined(one.hand, mine, _WIDE, None)
        if bench.obstacles.touched(there, other.hand.number, theirs, _WIDE) is not None:
            return False
    return True


def carry(
    bench: Bench, thing: str, taken: Sequence[Taken], arch: float = ARCH, speed: float = SPEED
) -> Iterator[Segment]:
    """Take points of a cloth, bring them where they are to lie, and let go.

    Args:
        arch: how high they are lifted on their way, as a share of it.
        speed: m/s.

    Raises:
        SkillFailedError: a hand missed its point.
    """
    wide = {one.hand: Fingers(_WIDE) for one in taken}
    for one in taken:
        yield bench.segment({one.hand: bench.way(one.hand, one.before, _WIDE)}, {one.hand: Fingers(_WIDE)})
    yield bench.segment({one.hand: bench.line(one.hand, one.T_at) for one in taken})
    yield from _take(bench, thing, taken)
    missed = [one.hand for one in taken if one.hand.side not in bench.world.holders(thing)]
    if not missed:
        yield bench.segment(_arches(bench, thing, taken, arch, speed))
        yield rest(bench)
    yield bench.segment({hand: bench.still(hand, GRIP_TICKS) for hand in wide}, wide)
    # Hands that pulled a layer alone are on it, not under it.
    under = [] if missed else [one for one in taken if not one.lay.alone]
    if under:
        yield bench.segment({one.hand: _withdrawn(bench, one) for one in under})
    up = {}
    for hand in wide:
        T_up = hand.pinch_at(hand.joints)
        T_up[2, 3] += _APPROACH
        up[hand] = bench.line(hand, T_up)
    yield bench.segment(up)
    if missed:
        sides = " and the ".join(sorted(hand.side for hand in missed))
        raise SkillFailedError(Cause.SLIPPED, f"the {sides} hand missed its corner of the {thing}")


def _take(bench: Bench, thing: str, taken: Sequence[Taken]) -> Iterator[Segment]:
    """Close hands on their points. One that takes a layer alone feels for it where it was not there: what lies hollow
    gives way to fingers that come down.
    """
    yield from _close(bench, taken)
    points = bench.world.points(thing)
    for deeper in _DEEPER:
        felt = [one for one in taken if one.lay.alone and one.hand.side not in bench.world.holders(thing)]
        if not felt:
            return
        opened = {one.hand: Fingers(_WIDE) for one in felt}
        yield bench.segment({hand: bench.still(hand, _OPEN_TICKS) for hand in opened}, opened)
        lines = {}
        for one in felt:
            # Tips stay off what the cloth lies on.
            lower = one.T_at.copy()
            lower[2, 3] -= min(deeper, float(points[one.lay.point][2] - points[..., 2].min()))
            lines[one.hand] = bench.line(one.hand, lower)
        yield bench.segment(lines)
        yield from _close(bench, felt)


def _close(bench: Bench, taken: Sequence[Taken]) -> Iterator[Segment]:
    """Close hands on what is between their fingers."""
    closing = {one.hand: Fingers(0.0, _FORCE) for one in taken}
    yield bench.segment({hand: bench.still(hand, GRIP_TICKS) for hand in closing}, closing)
    yield rest(bench)


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
    end_over = np.array([0.0, 0.0, high[2] - low[2] + _OVER])
    ends = {}
    for one in taken:
        T_now, point = one.hand.pinch_at(one.hand.joints), points[one.lay.point]
        in_pinch = T_now[:3, :3].T @ (point - T_now[:3, 3])
        ends[one.hand] = T_now, pose(one.lay.where(points) + end_over - one.R_end @ in_pinch, one.R_end)
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
