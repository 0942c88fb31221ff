"""Hands on cloth: they take it at points, bring these elsewhere on an arch, and let go."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..geometry.se3 import Array, pose, rotation_from_vector, rotation_z
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

# What is so near, seen from above, lies on each other, m.
_THERE = 0.012

# From so far a hand comes, and there it looks whether it touches anything; m.
_APPROACH = 0.08
_NEAR = 0.03

#: A fold goes on an arch so high, as a share of its way.
ARCH = 0.45

# Of a hand with cloth, m/s; and so much over where it lets go of it, m.
_SPEED = 0.12
_OVER = 0.002

# How far a hand may lean back to its arm, rad.
_LEANS = tuple(math.radians(angle) for angle in (0, 15, 30, 45))

#: Where a point of cloth is laid (3,), in `world`, m: of where its points (along y, along x, 3) are when a hand has it.
Where = Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class Lay:
    """A point of cloth that is taken, by row and column, and where it is laid."""

    point: tuple[int, int]
    where: Where


@dataclass(frozen=True, eq=False)
class Taken:
    """A hand at a point: its pinch frame (4, 4) there, and its joints (dof,) before it and where it ends."""

    hand: Hand
    lay: Lay
    T_at: Array
    before: Array
    end: Array


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
    """A hand at a point, leaning towards its arm as little as it reaches so; None where it does not reach it."""
    place = points[lay.point]
    way = lay.where(points) - place
    middle = place[:2] + way[:2] / 2
    away = middle - hand.arm.T_base_in_world[:2, 3]
    heading = math.atan2(away[1], away[0])
    inwards = points.reshape(-1, 3).mean(axis=0)[:2] - place[:2]
    # Fingers down and closing across the way from the arm, so that both tips are as high however the hand leans.
    level = rotation_z(heading + math.pi) @ np.diag([1.0, -1.0, -1.0])
    for lean in _LEANS:
        R = rotation_from_vector((lean * math.sin(heading), -lean * math.cos(heading), 0.0)) @ level
        up = _HALF_PAD * math.cos(lean) + _HALF_WIDTH * math.sin(lean) + _TIPS - _layers(points, place)
        T_at = pose((*(place[:2] + _INWARDS * inwards / np.linalg.norm(inwards)), place[2] + up), R)
        T_near = T_at.copy()
        T_near[2, 3] += _NEAR
        T_end = T_near.copy()
        T_end[:2, 3] += way[:2]
        near = hand.reach(T_near, (hand.ready,), PASSING)
        if near is None or hand.reach(T_at, (near,)) is None:
            continue
        end = hand.reach(T_end, (near,), PASSING)
        if end is None:
            continue
        before = hand.reach(T_at @ pose((0.0, 0.0, -_APPROACH)), (near,), PASSING)
        if before is None or bench.touched(hand, near, _WIDE) or bench.touched(hand, before, _WIDE):
            continue
        return Taken(hand, lay, T_at, before, end)
    return None


def _layers(points: Array, place: Array) -> float:
    """How much higher a place (3,) on a cloth is than the lowest point of it there, m."""
    flat = points.reshape(-1, 3)
    there = np.linalg.norm(flat[:, :2] - place[:2], axis=1) < _THERE
    return float(place[2] - flat[there, 2].min())


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


def carry(bench: Bench, thing: str, taken: Sequence[Taken], arch: float = ARCH) -> Iterator[Segment]:
    """Take points of a cloth, bring them where they are to lie, and let go.

    Args:
        arch: how high they are lifted on their way, as a share of it.

    Raises:
        SkillFailedError: a hand missed its point.
    """
    wide = {one.hand: Fingers(_WIDE) for one in taken}
    for one in taken:
        yield bench.segment({one.hand: bench.way(one.hand, one.before, _WIDE)}, {one.hand: Fingers(_WIDE)})
    yield bench.segment({one.hand: bench.line(one.hand, one.T_at) for one in taken})
    closing = {one.hand: Fingers(0.0, _FORCE) for one in taken}
    yield bench.segment({hand: bench.still(hand, GRIP_TICKS) for hand in closing}, closing)
    yield rest(bench)
    missed = [one.hand for one in taken if one.hand.side not in bench.world.holders(thing)]
    if not missed:
        yield bench.segment(_arches(bench, thing, taken, arch))
        yield rest(bench)
    yield bench.segment({hand: bench.still(hand, GRIP_TICKS) for hand in wide}, wide)
    up = {}
    for hand in wide:
        T_up = hand.pinch_at(hand.joints)
        T_up[2, 3] += _APPROACH
        up[hand] = bench.line(hand, T_up)
    yield bench.segment(up)
    if missed:
        sides = " and the ".join(sorted(hand.side for hand in missed))
        raise SkillFailedError(Cause.SLIPPED, f"the {sides} hand missed its corner of the {thing}")


def _arches(bench: Bench, thing: str, taken: Sequence[Taken], arch: float) -> dict[Hand, Array]:
    """Every hand's motion (n + 1, dof) with its point, from where that is now to where it is to lie."""
    points = bench.world.points(thing)
    low, high = bench.world.block(thing)
    end_over = np.array([0.0, 0.0, high[2] - low[2] + _OVER])
    ways = {one.hand: one.lay.where(points) - points[one.lay.point] + end_over for one in taken}
    length = max(float(np.linalg.norm(way[:2])) for way in ways.values())
    return {
        hand: bench.curve(hand, partial(_arch, hand.pinch_at(hand.joints), way, arch * length), length / _SPEED)
        for hand, way in ways.items()
    }


def _arch(T_start: Array, way: Array, height: float, share: float) -> Array:
    """A frame (4, 4) on its way over an arch so high, m."""
    T = T_start.copy()
    T[:2, 3] += way[:2] * (1 - math.cos(math.pi * share)) / 2
    T[2, 3] += way[2] * share + height * math.sin(math.pi * share)
    return T
