"""Motions of hands that grasp points of cloth, carry them to their targets on an arch, and release them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np

from yamsim_cli.core.geometry.se3 import Array, interpolate_rotation, pose
from yamsim_cli.core.sim.cloth import between_pads, simulated_pull
from yamsim_cli.core.types import Cause

from ..bench import Bench, Fingers, Segment, SkillFailedError
from ..hand import Hand
from ..moves import GRIP_TICKS, idle, rest
from .reach import APPROACH, APPROACH_OPENING, TIP_CLEARANCE, PointGrasp, clear_of

SPEED = 0.12  # m/s, of a hand with cloth
ARCH = 0.45  # height of the path of a fold, as a share of its length

_FORCE = 20.0  # N, of closed fingers on cloth

# m; depths of further grasps after a miss, each in steps of `_DEPTH_STEP`.
_DEPTH_STEP = 0.002
_DEPTHS = (_DEPTH_STEP, 2 * _DEPTH_STEP, 3 * _DEPTH_STEP, 4 * _DEPTH_STEP)
_OPEN_TICKS = 4  # control ticks in which fingers open before a further grasp

_STUCK_OPENING = 2 * APPROACH_OPENING  # m, of a finger commanded to `APPROACH_OPENING`, above which it counts as stuck
_CLOSED_OPENING = 0.006  # m, of a closed finger: more than cloth is thick, and far less than `APPROACH_OPENING`

_WITHDRAWAL = 0.04  # m, of a hand out from under the cloth that it placed
_DROP_HEIGHT = 0.002  # m, over the target, at which a folded point is released
_PULL_HEIGHT = 0.006  # m, of a pull over the table: tips that rub on the table hold arms back by 2 to 4 cm


def predicted_points(
    bench: Bench, thing: str, grasps: Sequence[PointGrasp], arch: float = ARCH, speed: float = SPEED
) -> Array:
    """A cloth's points (along y, along x, 3) in `world` after `carry` with the same arguments, m.

    The points come from a simulation of the cloth without hands, in which the grasped points move on prescribed paths.
    """
    cloth, points = bench.world.cloth(thing), bench.world.points(thing)
    patches = []
    for grasp in grasps:
        row, column = grasp.placement.point
        between = between_pads(cloth, points.reshape(-1, 3), grasp.T_at)
        patches.append(np.union1d(between, [row * points.shape[1] + column]))
    paths = [grasp.placement.target(points) - points[grasp.placement.point] for grasp in grasps]
    seconds = max(float(np.linalg.norm(path[:2])) for path in paths) / speed
    return simulated_pull(bench.world.data, bench.model, cloth, patches, paths, arch, seconds)


def carry(
    bench: Bench, thing: str, grasps: Sequence[PointGrasp], arch: float = ARCH, speed: float = SPEED
) -> Iterator[Segment]:
    """Grasp points of a cloth, carry them to their targets, and release them.

    Args:
        arch: height of the path, as a share of its length.
        speed: m/s.

    Raises:
        SkillFailedError: a hand missed its point, or its fingers do not close.
    """
    opened = {grasp.hand: Fingers(APPROACH_OPENING) for grasp in grasps}
    yield from _approached(bench, grasps)
    _check_fingers(bench, grasps)
    yield bench.segment({grasp.hand: bench.line(grasp.hand, grasp.T_at) for grasp in grasps})
    yield from _grasp(bench, thing, grasps)
    missed = [grasp.hand for grasp in grasps if grasp.hand.side not in bench.world.holders(thing)]
    if not missed:
        yield bench.segment(_arches(bench, thing, grasps, arch, speed))
        yield rest(bench)
    yield bench.segment({hand: bench.still(hand, GRIP_TICKS) for hand in opened}, opened, arrives=False)
    # A hand that pulled a single layer is above the cloth, unless a finger came to be under the edge.
    beneath = bench.world.hands_beneath(thing)
    under = [] if missed else [grasp for grasp in grasps if not grasp.placement.alone or grasp.hand.side in beneath]
    if under:
        yield bench.segment({grasp.hand: _withdrawal(bench, grasp) for grasp in under}, arrives=False)
    up = {}
    for hand in opened:
        T_up = hand.pinch_at(hand.joints)
        T_up[2, 3] += APPROACH
        up[hand] = bench.line(hand, T_up)
    yield bench.segment(up, arrives=False)
    if missed:
        sides = " and the ".join(sorted(hand.side for hand in missed))
        raise SkillFailedError(Cause.SLIPPED, f"the {sides} hand missed its corner of the {thing}")


def _approached(bench: Bench, grasps: Sequence[PointGrasp]) -> Iterator[Segment]:
    """Move hands to the starts of their approaches, and idle hands out of the way: together, if their paths are clear
    of each other.
    """
    opened = {grasp.hand: Fingers(APPROACH_OPENING) for grasp in grasps}
    goals = {hand: hand.ready for hand in idle(bench) if hand not in opened}
    goals |= {grasp.hand: grasp.before for grasp in grasps}
    paths = {hand: bench.free_path(hand, goal, APPROACH_OPENING) for hand, goal in goals.items()}
    if _free_together(bench, paths):
        yield bench.segment(paths, opened, arrives=False)
        return
    for hand, goal in goals.items():
        fingers = {hand: opened[hand]} if hand in opened else {}
        yield bench.segment({hand: bench.free_path(hand, goal, APPROACH_OPENING)}, fingers, arrives=False)


def _check_fingers(bench: Bench, grasps: Sequence[PointGrasp]) -> None:
    """Raise `SkillFailedError` if fingers are stuck open.

    Open fingers would push through cloth that stands up beside a point, and grasp it too.
    """
    for grasp in grasps:
        if bench.opening(grasp.hand) > _STUCK_OPENING:
            raise SkillFailedError(Cause.SLIPPED, f"the {grasp.hand.side} hand's fingers do not close")


def _free_together(bench: Bench, paths: Mapping[Hand, Array]) -> bool:
    """Whether hands that move on their paths (n + 1, dof) at once do not touch each other."""
    ticks = max(len(path) for path in paths.values())
    for tick in range(ticks):
        there = [(hand, path[min(tick, len(path) - 1)]) for hand, path in paths.items()]
        if not all(clear_of(bench, one, other) for one, other in itertools.combinations(there, 2)):
            return False
    return True


def _grasp(bench: Bench, thing: str, grasps: Sequence[PointGrasp]) -> Iterator[Segment]:
    """Close hands on their points; hands that miss try again at lower heights.

    A hand misses because its arm comes to rest a little too high, or because hollow cloth gives way to its fingers.
    """
    yield from _close(bench, grasps)
    points = bench.world.points(thing)
    limits = {grasp.hand: _max_depth(points, grasp) for grasp in grasps}
    for depth in _DEPTHS:
        holders = bench.world.holders(thing)
        retried = [
            grasp
            for grasp in grasps
            if grasp.hand.side not in holders
            and depth - _DEPTH_STEP < limits[grasp.hand]
            and _closed(bench, grasp.hand)
        ]
        if not retried:
            return
        opened = {grasp.hand: Fingers(APPROACH_OPENING) for grasp in retried}
        yield bench.segment({hand: bench.still(hand, _OPEN_TICKS) for hand in opened}, opened)
        lines = {}
        for grasp in retried:
            lower = grasp.T_at.copy()
            lower[2, 3] -= min(depth, limits[grasp.hand])
            lines[grasp.hand] = bench.line(grasp.hand, lower)
        yield bench.segment(lines)
        yield from _close(bench, retried)


def _max_depth(points: Array, grasp: PointGrasp) -> float:
    """The depth of a further grasp, m, at which the tips reach what is under the cloth (along y, along x, 3)."""
    hollow = float(points[grasp.placement.point][2] - points[..., 2].min()) if grasp.placement.alone else 0.0
    return hollow + TIP_CLEARANCE


def _close(bench: Bench, grasps: Sequence[PointGrasp]) -> Iterator[Segment]:
    """Close hands on the cloth between their fingers."""
    closing = {grasp.hand: Fingers(0.0, _FORCE) for grasp in grasps}
    yield bench.segment({hand: bench.still(hand, GRIP_TICKS) for hand in closing}, closing)
    yield rest(bench)


def _closed(bench: Bench, hand: Hand) -> bool:
    """Whether commanded fingers did close; others only press cloth down."""
    return bench.opening(hand) < _CLOSED_OPENING


def _withdrawal(bench: Bench, grasp: PointGrasp) -> Array:
    """A hand's motion (n + 1, dof) out from under the cloth, laterally or forward; at rest if neither is reachable."""
    for direction in (grasp.lateral, grasp.forward):
        T = grasp.hand.pinch_at(grasp.hand.joints)
        T[:2, 3] += _WITHDRAWAL * direction
        T[2, 3] += _WITHDRAWAL / 4
        try:
            return bench.line(grasp.hand, T)
        except SkillFailedError:
            continue
    return bench.still(grasp.hand, 1)


def _arches(bench: Bench, thing: str, grasps: Sequence[PointGrasp], arch: float, speed: float) -> dict[Hand, Array]:
    """Every hand's motion (n + 1, dof) that carries its point from the present place to the target."""
    points = bench.world.points(thing)
    low, high = bench.world.block(thing)
    ends = {}
    for grasp in grasps:
        T_now, point = grasp.hand.pinch_at(grasp.hand.joints), points[grasp.placement.point]
        in_pinch = T_now[:3, :3].T @ (point - T_now[:3, 3])
        # A folded point comes down onto all layers at the target; a point that is pulled alone stays low.
        over = np.array([0.0, 0.0, _PULL_HEIGHT if grasp.placement.alone else high[2] - low[2] + _DROP_HEIGHT])
        ends[grasp.hand] = (
            T_now,
            pose(grasp.placement.target(points) + over - grasp.R_end @ in_pinch, grasp.R_end),
        )
    length = max(float(np.linalg.norm((T_end - T_now)[:2, 3])) for T_now, T_end in ends.values())
    return {
        hand: bench.curve(hand, partial(_arch, *both, arch * length), length / speed) for hand, both in ends.items()
    }


def _arch(T_start: Array, T_end: Array, height: float, share: float) -> Array:
    """The pose (4, 4) at a share, 0..1, of a path from one pose to another over an arch of a height in m."""
    path, across = T_end[:3, 3] - T_start[:3, 3], (1 - math.cos(math.pi * share)) / 2
    up = path[2] * share + height * math.sin(math.pi * share)
    R = interpolate_rotation(T_start[:3, :3], T_end[:3, :3], across)
    return pose(T_start[:3, 3] + [*(path[:2] * across), up], R)
