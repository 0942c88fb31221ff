"""Ways of a hand from where it is to other joints, on which it touches nothing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..geometry.se3 import Array
from ..planning.joint_motion import LINE_SPEED, clear, straight, through
from ..planning.tree_search import search
from .hand import PASSING, Hand

# Over the table, a hand that crosses it stays at least so high, m.
_CROSSING = 0.22
_RAISE = 0.05

# A hand leaves what it touches in steps of so much, m, so many at most.
_LEAVING, _LEAVING_STEPS = 0.02, 6

# What an arm would touch with joints (dof,); None is nothing.
Touched = Callable[[Array], str | None]


def free_way(hand: Hand, goal: Array, touched: Touched, tick: float, rng: np.random.Generator) -> Array | None:
    """The simplest motion (n + 1, dof) of a hand to joints `goal` (dof,) that touches nothing; None if none was found.

    A hand that touches something where it begins, as one that has just let go may, leaves that straight up where
    there is no other way.

    Args:
        tick: of control, s.
        rng: of the search, where nothing simple is free.
    """
    path = _way(hand, hand.joints, goal, touched, tick, rng)
    if path is None and touched(hand.joints) is not None and (leaving := _leaving(hand, touched, tick)) is not None:
        onwards = _way(hand, leaving[-1], goal, touched, tick, rng)
        path = None if onwards is None else np.concatenate([leaving[:-1], onwards])
    return path


def _way(
    hand: Hand, start: Array, goal: Array, touched: Touched, tick: float, rng: np.random.Generator
) -> Array | None:
    for points in _simple_ways(hand, start, goal):
        path = through(points, hand.arm.motor_speed, tick)
        if clear(path, touched):
            return path
    found = search(start, goal, hand.arm.joint_range, touched, rng)
    return None if found is None else through(found, hand.arm.motor_speed, tick)


def _leaving(hand: Hand, touched: Touched, tick: float) -> Array | None:
    """Straight up, as far as it takes until a hand touches nothing."""
    T = hand.pinch_at(hand.joints)
    for _ in range(_LEAVING_STEPS):
        T[2, 3] += _LEAVING
        path = straight(hand.ik, hand.joints, T, tick, LINE_SPEED)
        if path is not None and touched(path[-1]) is None:
            return path
    return None


def _simple_ways(hand: Hand, start: Array, goal: Array) -> list[list[Array]]:
    """Straight there; or up, across and down; or by way of the posture in which the arm is ready."""
    raised = []
    for joints in (start, goal):
        T = hand.pinch_at(joints)
        T[2, 3] = max(T[2, 3] + _RAISE, _CROSSING)
        raised.append(hand.reach(T, [joints], PASSING))
    up, down = raised
    ways = [[start, goal]]
    if up is not None and down is not None:
        ways.append([start, up, down, goal])
    ways += [[start, via, goal] for via in (down, up, hand.ready) if via is not None]
    return ways
