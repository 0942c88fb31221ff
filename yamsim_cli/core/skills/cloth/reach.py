"""Points of cloth that hands take, and where they lay them: which hands reach that, and how."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...geometry.se3 import Array, pose, rotation_from_vector, rotation_z
from ..bench import Bench
from ..hand import PASSING, Hand

#: Fingers open so far each before they close on cloth, m.
WIDE = 0.012

#: Tips are so much over a point that is taken: they press on the cloth, and stay off what it lies on, m.
TIPS = 0.001
# The pinch frame is half a pad over them, m. And so far inwards, so that both pads come down on cloth.
_HALF_PAD, _HALF_WIDTH = 0.0082, 0.0072
_INWARDS = 0.007

# Around the middle between its open fingers a hand takes so much room, of which they leave so much for cloth between
# them, along x and along y. Cloth beside them that stands higher over their tips than this would end up on a finger.
# All in m.
_ROOM, _BETWEEN = 0.024, (0.009, 0.011)
_STANDING = 0.03

# Of a layer that lies on others, a hand takes hold beside a point on the side of points up to so many cells away.
_NEXT = 2

# What is so near, seen from above, lies on each other, m.
_THERE = 0.012

#: From so far a hand comes, m. And nearer it looks whether it touches anything, m.
APPROACH = 0.08
_NEAR = 0.03

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


def reached(bench: Bench, thing: str, lays: Sequence[Lay], points: Array | None = None) -> list[Taken] | None:
    """How free hands take points of a cloth, each its own; None if they do not reach these, or where they are laid.

    Args:
        points: where the cloth's points (along y, along x, 3) would be; without, where they are.
    """
    points = bench.world.points(thing) if points is None else points
    free = bench.free_hands("any")
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
        up = _HALF_PAD * math.cos(lean) + _HALF_WIDTH * math.sin(lean) + TIPS
        up -= 0.0 if lay.alone else _layers(points, place)
        T_at = pose((*(place[:2] + _INWARDS * inwards), place[2] + up), R)
        if lay.alone and _stands_beside(points, T_at):
            continue
        T_near = T_at.copy()
        T_near[2, 3] += _NEAR
        near = hand.reach(T_near, (hand.ready,), PASSING)
        at = None if near is None else hand.reach(T_at, (near,))
        if near is None or at is None or bench.obstacles.meets_itself(hand.number, at):
            continue
        before = hand.reach(T_at @ pose((0.0, 0.0, -APPROACH)), (near,), PASSING)
        if before is None or bench.touched(hand, near, WIDE) or bench.touched(hand, before, WIDE):
            continue
        for R_end in (R, *(turn for turn in turns if turn is not R)):
            end = hand.reach(pose(T_near[:3, 3] + [*way[:2], 0.0], R_end), (near,), PASSING)
            if end is not None and not bench.obstacles.meets_itself(hand.number, end):
                return Taken(hand, lay, T_at, R_end, before, end, ahead, aside)
    return None


def _stands_beside(points: Array, T_at: Array) -> bool:
    """Whether cloth stands up beside the fingers of a hand that comes down on it to a pose (4, 4)."""
    seen = (points.reshape(-1, 3) - T_at[:3, 3]) @ T_at[:3, :3]
    across = np.abs(seen[:, :2])
    beside = (across < _ROOM).all(axis=1) & ~(across < _BETWEEN).all(axis=1)
    return bool((_HALF_PAD - seen[beside, 2] > _STANDING).any())


def _layers(points: Array, place: Array) -> float:
    """How much higher a place (3,) on a cloth is than the lowest point of it there, m."""
    flat = points.reshape(-1, 3)
    there = np.linalg.norm(flat[:, :2] - place[:2], axis=1) < _THERE
    return float(place[2] - flat[there, 2].min())


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
    ends = [[(one.hand, one.before) for one in taken], [(one.hand, one.end) for one in taken]]
    return all(clear_of(bench, *both) for both in ends)


def clear_of(bench: Bench, one: tuple[Hand, Array], other: tuple[Hand, Array]) -> bool:
    """Whether two hands with given joints (dof,), about to take cloth, do not touch each other. Their fingers may be as
    far open as they are yet.
    """
    (hand, joints), (beside, its_joints) = one, other
    there = bench.posed_qpos(hand, joints, max(WIDE, hand.opening), None)
    return bench.obstacles.touched(there, beside.number, its_joints, max(WIDE, beside.opening)) is None
