"""Motions of one arm in joint space, one reference a control tick."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from ..geometry.se3 import Array, interpolate_rotation, pose, rotation_vector
from .ik import IkSolver

# The fastest that a demonstration moves a joint: a share of its motor's no-load speed, and so many rad/s.
_SPEED_SHARE = 0.55
_SPEED = 2.2

# A minimum-jerk motion's peak speed, as a multiple of its mean.
_PEAK = 1.875
# The same where it does not stop at its ends.
_PASSING_PEAK = 1.5

# Of a hand on a straight line, m/s and rad/s, and the fewest ticks that take it anywhere.
LINE_SPEED = 0.25
_LINE_TURN = 1.2
_FEWEST_TICKS = 6

# Farther from its line, or farther from one tick to the next, a hand has left the arm's reach; m and rad.
_OFF_LINE = 0.004
_JUMP = 0.35
_LINE_ITERATIONS = 8


def ease(fraction: float) -> float:
    """Minimum jerk from 0 to 1."""
    return fraction**3 * (10 - 15 * fraction + 6 * fraction**2)


def through(points: Sequence[Array], motor_speed: Array, tick: float) -> Array:
    """Joints (n + 1, dof) at the ticks' boundaries of a motion from rest through points to rest, as fast as is fair.

    Args:
        points: joints (dof,), the present ones first, rad.
        motor_speed: no-load speed of each joint's motor (dof,), rad/s.
        tick: length of a control tick, s.
    """
    limit = np.minimum(motor_speed * _SPEED_SHARE, _SPEED)
    knots = np.asarray(points)
    peak = _PEAK if len(knots) == 2 else _PASSING_PEAK
    steps = np.diff(knots, axis=0)
    ticks = [max(_FEWEST_TICKS, math.ceil(float((np.abs(step) / limit).max()) * peak / tick)) for step in steps]
    velocities = [np.zeros(knots.shape[1])]
    for k in range(1, len(steps)):
        velocity = (knots[k + 1] - knots[k - 1]) / ((ticks[k - 1] + ticks[k]) * tick)
        # A joint that turns back at a point stands still there.
        velocities.append(np.where(steps[k] * steps[k - 1] > 0, velocity, 0.0))
    velocities.append(np.zeros(knots.shape[1]))
    rows = [knots[0]]
    for k, number in enumerate(ticks):
        duration = number * tick
        for step in range(1, number + 1):
            u = step / number
            leave = u - 6 * u**3 + 8 * u**4 - 3 * u**5
            arrive = -4 * u**3 + 7 * u**4 - 3 * u**5
            rows.append(knots[k] + ease(u) * steps[k] + duration * (leave * velocities[k] + arrive * velocities[k + 1]))
    return np.array(rows)


def straight(
    ik: IkSolver, start: Array, T_tool_in_world: Array, tick: float, speed: float = LINE_SPEED
) -> Array | None:
    """Joints (n + 1, dof) that take the held frame along a straight line to a pose (4, 4), from rest to rest.

    Args:
        ik: solves for the frame that is to move straight, see `IkSolver.hold`.
        start: the present joints (dof,), rad.
        speed: of the frame, m/s.

    Returns:
        The motion, or None where the line leaves the arm's reach.
    """
    T_start = ik.pose_of(start)
    distance = float(np.linalg.norm(T_tool_in_world[:3, 3] - T_start[:3, 3]))
    turn = float(np.linalg.norm(rotation_vector(T_start[:3, :3].T @ T_tool_in_world[:3, :3])))

    def on_line(share: float) -> Array:
        position = T_start[:3, 3] + share * (T_tool_in_world[:3, 3] - T_start[:3, 3])
        return pose(position, interpolate_rotation(T_start[:3, :3], T_tool_in_world[:3, :3], share))

    return traced(ik, start, on_line, max(distance / speed, turn / _LINE_TURN), tick)


def traced(ik: IkSolver, start: Array, pose_at: Callable[[float], Array], seconds: float, tick: float) -> Array | None:
    """Joints (n + 1, dof) that take the held frame along a curve, from rest to rest.

    Args:
        ik: solves for the frame that is to move, see `IkSolver.hold`.
        start: the present joints (dof,), rad.
        pose_at: share of the way, 0..1 -> the frame's pose (4, 4) in `world`.
        seconds: how long it would take at its mean speed.

    Returns:
        The motion, or None where the curve leaves the arm's reach.
    """
    number = max(_FEWEST_TICKS, math.ceil(seconds * _PEAK / tick))
    rows, solution = [start], ik.at(start)
    for step in range(1, number + 1):
        solution = ik.follow(pose_at(ease(step / number)), solution, _LINE_ITERATIONS)
        if solution.position_error > _OFF_LINE or float(np.abs(solution.joints - rows[-1]).max()) > _JUMP:
            return None
        rows.append(solution.joints)
    return np.array(rows)


def clear(path: Array, touched: Callable[[Array], str | None], step: float = 0.02) -> bool:
    """Whether nothing is touched along a motion (n + 1, dof), looked at every `step` rad."""
    last = path[0]
    for joints in (*path[1:-1], path[-1]):
        if joints is not path[-1] and float(np.abs(joints - last).max()) < step:
            continue
        last = joints
        if touched(joints):
            return False
    return True
