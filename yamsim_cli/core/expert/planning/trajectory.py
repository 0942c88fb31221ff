from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from ...geometry.se3 import Array, pose, rotation_from_vector, rotation_vector
from .ik import IkSolver

_MAX_SPEED_SHARE = 0.55  # of the motor's no-load speed
_MAX_SPEED = 2.2  # rad/s, of a joint

_PEAK_SPEED_RATIO = 1.875  # peak speed over mean speed of a minimum-jerk motion
_WAYPOINT_PEAK_SPEED_RATIO = 1.5  # peak speed over mean speed of a motion through waypoints without stops

LINE_SPEED = 0.25  # m/s, peak speed of a hand
_LINE_TURN_SPEED = 1.2  # rad/s, peak rotation speed of a hand on a line
_MIN_TICKS = 6  # control ticks of the shortest motion

_MAX_LINE_ERROR = 0.004  # m, distance from the curve above which a pose counts as out of reach
_MAX_JOINT_STEP = 0.35  # rad, change of a joint in a control tick above which a pose counts as out of reach
_LINE_ITERATIONS = 8  # of each inverse kinematics search


def minimum_jerk(fraction: float) -> float:
    """Return the position, 0..1, of a minimum-jerk motion at a fraction of its duration."""
    return fraction**3 * (10 - 15 * fraction + 6 * fraction**2)


def time_waypoints(points: Sequence[Array], motor_speed: Array, tick: float) -> Array:
    """Return joints (n + 1, dof) at tick boundaries that pass through waypoints, from rest to rest within speed limits.

    The first waypoint is the present joints. `motor_speed` (dof,) is the no-load speed, rad/s.
    """
    limit = np.minimum(motor_speed * _MAX_SPEED_SHARE, _MAX_SPEED)
    knots = np.asarray(points)
    peak = _PEAK_SPEED_RATIO if len(knots) == 2 else _WAYPOINT_PEAK_SPEED_RATIO
    steps = np.diff(knots, axis=0)
    ticks = [max(_MIN_TICKS, math.ceil(float((np.abs(step) / limit).max()) * peak / tick)) for step in steps]
    velocities = [np.zeros(knots.shape[1])]
    for k in range(1, len(steps)):
        velocity = (knots[k + 1] - knots[k - 1]) / ((ticks[k - 1] + ticks[k]) * tick)
        # A joint that reverses at a waypoint has no speed there.
        velocities.append(np.where(steps[k] * steps[k - 1] > 0, velocity, 0.0))
    velocities.append(np.zeros(knots.shape[1]))
    rows = [knots[0]]
    for k, number in enumerate(ticks):
        duration = number * tick
        for step in range(1, number + 1):
            u = step / number
            leave = u - 6 * u**3 + 8 * u**4 - 3 * u**5
            arrive = -4 * u**3 + 7 * u**4 - 3 * u**5
            rows.append(
                knots[k] + minimum_jerk(u) * steps[k] + duration * (leave * velocities[k] + arrive * velocities[k + 1])
            )
    return np.array(rows)


def plan_cartesian_line(
    ik: IkSolver, start: Array, T_tool_in_world: Array, tick: float, speed: float = LINE_SPEED
) -> Array | None:
    """Return joints (n + 1, dof) that move the held frame of `ik` straight to a pose, from rest to rest.

    The frame's peak speed is `speed`, m/s. The result is None if the line leaves the arm's reach.
    """
    T_start = ik.forward_kinematics(start)
    distance = float(np.linalg.norm(T_tool_in_world[:3, 3] - T_start[:3, 3]))
    turn = rotation_vector(T_start[:3, :3].T @ T_tool_in_world[:3, :3])

    def pose_on_line(share: float) -> Array:
        position = T_start[:3, 3] + share * (T_tool_in_world[:3, 3] - T_start[:3, 3])
        return pose(position, T_start[:3, :3] @ rotation_from_vector(share * turn))

    seconds = max(distance / speed, float(np.linalg.norm(turn)) / _LINE_TURN_SPEED)
    return plan_cartesian_curve(ik, start, pose_on_line, seconds, tick)


def plan_cartesian_curve(
    ik: IkSolver, start: Array, pose_at: Callable[[float], Array], seconds: float, tick: float
) -> Array | None:
    """Return joints (n + 1, dof) that move the held frame of `ik` on a curve, from rest to rest.

    `pose_at` gives the pose in `world` at a share of the curve, 0..1. The curve takes `seconds` at the peak speed; the
    motion lasts 1.875 times as long. The result is None if the curve leaves the arm's reach.
    """
    number = max(_MIN_TICKS, math.ceil(seconds * _PEAK_SPEED_RATIO / tick))
    rows, solution = [start], ik.solution_at(start)
    for step in range(1, number + 1):
        solution = ik.solve_next(pose_at(minimum_jerk(step / number)), solution, _LINE_ITERATIONS)
        if (
            solution.position_error > _MAX_LINE_ERROR
            or float(np.abs(solution.joints - rows[-1]).max()) > _MAX_JOINT_STEP
        ):
            return None
        rows.append(solution.joints)
    return np.array(rows)


def is_collision_free(path: Array, find_contact: Callable[[Array], str | None], step: float = 0.02) -> bool:
    """Return whether a motion (n + 1, dof) has no contacts, checked every `step` rad and at its end."""
    last = path[0]
    for joints in (*path[1:-1], path[-1]):
        if joints is not path[-1] and float(np.abs(joints - last).max()) < step:
            continue
        last = joints
        if find_contact(joints):
            return False
    return True
