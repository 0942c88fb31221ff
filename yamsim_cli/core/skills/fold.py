"""Fold cloth: take it at corners and lay them onto others."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from ..geometry.folding import Fold as Way
from ..geometry.se3 import Array, pose, rotation_from_vector, rotation_z
from ..goals.cast import Cast
from ..types import Cause
from .base import Skill
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

# From so far a hand comes, and there it looks whether it touches anything; m.
_APPROACH = 0.08
_NEAR = 0.03

# A corner goes on an arch so high, as a share of its way, and at this speed, m/s; it ends so much over where it is let
# go, m.
_ARCH = 0.45
_SPEED = 0.12
_OVER = 0.002

# How far a hand may lean back to its arm, rad.
_LEANS = tuple(math.radians(angle) for angle in (0, 15, 30, 45))


@dataclass(frozen=True)
class _Move:
    """Corners that are taken, by row and column, and where each is laid."""

    corners: tuple[tuple[int, int], ...]
    onto: tuple[tuple[int, int], ...]


@dataclass(frozen=True, eq=False)
class _Taken:
    """A hand at a corner: its pinch frame (4, 4) there, and its joints (dof,) before it."""

    hand: Hand
    corner: tuple[int, int]
    onto: tuple[int, int]
    T_at: Array
    before: Array


class Fold(Skill):
    """Fold cloth that lies flat once: in half with two hands, along a diagonal with one.

    Attributes:
        thing: a role, which cloth plays.
        how: which way.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    NEEDS: ClassVar[bool | None] = False
    OF_CLOTH: ClassVar[bool] = True
    thing: str
    how: Way = "half"

    @property
    def hands(self) -> int:
        """How many it takes."""
        return 1 if self.how == "diagonal" else 2

    @property
    def said(self) -> str:
        """Which way, in words."""
        return {"half": "in half", "diagonal": "along a diagonal"}[self.how]

    def run(self, bench: Bench, cast: Cast, ahead: Sequence[Skill]) -> Iterator[Segment]:
        """See `Skill`."""
        thing = cast.one(self.thing)
        rows, columns = bench.world.points(thing).shape[:2]
        for move in _moves(self.how, rows, columns):
            if taken := _reached(bench, thing, move):
                yield from _fold(bench, thing, taken)
                return
        raise SkillFailedError(Cause.UNREACHABLE, f"no hands reach corners of the {thing} and where they are to lie")


def _moves(how: Way, rows: int, columns: int) -> list[_Move]:
    """The moves that fold a grid of points so, each in its own way."""
    last = (rows - 1, columns - 1)
    if how == "diagonal":
        corners = [(0, 0), (0, last[1]), (last[0], 0), last]
        return [_Move((one,), ((last[0] - one[0], last[1] - one[1]),)) for one in corners]
    low, high = ((0, 0), (0, last[1])), ((last[0], 0), last)
    left, right = ((0, 0), (last[0], 0)), ((0, last[1]), last)
    return [_Move(low, high), _Move(high, low), _Move(left, right), _Move(right, left)]


def _reached(bench: Bench, thing: str, move: _Move) -> list[_Taken] | None:
    """How free hands take the corners of a move; None if they do not reach them, or where they are to lie."""
    points = bench.world.points(thing)
    free = [hand for hand in bench.hands if hand.held is None]
    pairs = list(zip(move.corners, move.onto, strict=True))
    for hands in itertools.permutations(free, len(pairs)):
        # Arms do not cross: the farther to the left a hand's arm stands, the farther to the left is its corner.
        sides = [hand.arm.T_base_in_world[1, 3] for hand in hands]
        places = [points[corner][1] for corner, _ in pairs]
        if len(pairs) > 1 and (sides[0] - sides[1]) * (places[0] - places[1]) <= 0:
            continue
        found = [_taken(bench, hand, points, pair) for hand, pair in zip(hands, pairs, strict=True)]
        taken = [one for one in found if one is not None]
        if len(taken) == len(pairs) and _apart(bench, taken):
            return taken
    return None


def _taken(bench: Bench, hand: Hand, points: Array, pair: tuple[tuple[int, int], tuple[int, int]]) -> _Taken | None:
    """A hand at a corner, leaning towards its arm as little as it reaches so; None where it does not reach it."""
    corner, onto = pair
    place, way = points[corner], points[onto] - points[corner]
    middle = place[:2] + way[:2] / 2
    away = middle - hand.arm.T_base_in_world[:2, 3]
    heading = math.atan2(away[1], away[0])
    inwards = points.reshape(-1, 3).mean(axis=0)[:2] - place[:2]
    # Fingers down and closing across the way from the arm, so that both tips are as high however the hand leans.
    level = rotation_z(heading + math.pi) @ np.diag([1.0, -1.0, -1.0])
    for lean in _LEANS:
        R = rotation_from_vector((lean * math.sin(heading), -lean * math.cos(heading), 0.0)) @ level
        up = _HALF_PAD * math.cos(lean) + _HALF_WIDTH * math.sin(lean) + _TIPS
        T_at = pose((*(place[:2] + _INWARDS * inwards / np.linalg.norm(inwards)), place[2] + up), R)
        T_near = T_at.copy()
        T_near[2, 3] += _NEAR
        T_end = T_near.copy()
        T_end[:2, 3] += way[:2]
        near = hand.reach(T_near, (hand.ready,), PASSING)
        if near is None or hand.reach(T_at, (near,)) is None or hand.reach(T_end, (near,), PASSING) is None:
            continue
        before = hand.reach(T_at @ pose((0.0, 0.0, -_APPROACH)), (near,), PASSING)
        if before is None or bench.touched(hand, near, _WIDE) or bench.touched(hand, before, _WIDE):
            continue
        return _Taken(hand, corner, onto, T_at, before)
    return None


def _apart(bench: Bench, taken: Sequence[_Taken]) -> bool:
    """Whether two hands that come to their corners at once do not touch each other."""
    if len(taken) < 2:
        return True
    one, other = taken
    there = bench.imagined(one.hand, one.before, _WIDE, None)
    return bench.obstacles.touched(there, other.hand.number, other.before, _WIDE) is None


def _fold(bench: Bench, thing: str, taken: Sequence[_Taken]) -> Iterator[Segment]:
    """Take the corners, lay them where they are to lie, and let go."""
    wide = {one.hand: Fingers(_WIDE) for one in taken}
    for one in taken:
        yield bench.segment({one.hand: bench.way(one.hand, one.before, _WIDE)}, {one.hand: Fingers(_WIDE)})
    yield bench.segment({one.hand: bench.line(one.hand, one.T_at) for one in taken})
    closing = {one.hand: Fingers(0.0, _FORCE) for one in taken}
    yield bench.segment({hand: bench.still(hand, GRIP_TICKS) for hand in closing}, closing)
    yield rest(bench)
    missed = [one.hand for one in taken if one.hand.side not in bench.world.holders(thing)]
    if not missed:
        yield bench.segment(_arches(bench, thing, taken))
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


def _arches(bench: Bench, thing: str, taken: Sequence[_Taken]) -> dict[Hand, Array]:
    """Every hand's motion (n + 1, dof) with its corner, from where that is now to where it is to lie."""
    points = bench.world.points(thing)
    low, high = bench.world.block(thing)
    end_over = np.array([0.0, 0.0, high[2] - low[2] + _OVER])
    ways = {one.hand: points[one.onto] - points[one.corner] + end_over for one in taken}
    length = max(float(np.linalg.norm(way[:2])) for way in ways.values())
    return {
        hand: bench.curve(hand, partial(_arch, hand.pinch_at(hand.joints), way, _ARCH * length), length / _SPEED)
        for hand, way in ways.items()
    }


def _arch(T_start: Array, way: Array, height: float, share: float) -> Array:
    """A frame (4, 4) on its way over an arch so high, m."""
    T = T_start.copy()
    T[:2, 3] += way[:2] * (1 - math.cos(math.pi * share)) / 2
    T[2, 3] += way[2] * share + height * math.sin(math.pi * share)
    return T
