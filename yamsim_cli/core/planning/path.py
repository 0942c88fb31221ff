"""Turns a plan's waypoints into joint references, one for each control tick."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..config.task import Timing
from ..geometry.se3 import Array, interpolate_rotation, inverse, pose, tilt
from ..types import JointPath, Plan, Stand
from .dynamics import ArmDynamics
from .ik import IkSolver

# Iterations of inverse kinematics to the first waypoint, which may have to cross the workspace.
_COLD_ITERATIONS = 100
# Iterations for each tick of a path, which starts next to its solution.
_ITERATIONS = 12


def plan_path(ik: IkSolver, dynamics: ArmDynamics, plan: Plan, start_joints: Array, timing: Timing) -> JointPath:
    """The path of a plan, solved tick by tick; at its end the arm goes back to the start while everything settles.

    The caller decides whether the path's errors are small enough.

    Args:
        start_joints: the arm's joints (dof,) at rest before the first tick, rad.

    Returns:
        The path; whether its errors are small enough is for the caller to say.
    """
    ik.hold(plan.T_object_in_pinch)
    T_pinch_in_object = inverse(plan.T_object_in_pinch)
    knots = [ik.pose_of(start_joints), *(waypoint.T_object_in_world for waypoint in plan.waypoints)]
    durations = [waypoint.ticks * timing.tick for waypoint in plan.waypoints]
    velocities = _knot_velocities(plan, knots, durations)

    first = solution = ik.solve(plan.waypoints[0].T_object_in_world, start_joints, _COLD_ITERATIONS)
    joints, gripper, grip = [start_joints], [], []
    position_error, leaned = 0.0, 0.0
    before = plan.waypoints[0]
    for index, waypoint in enumerate(plan.waypoints):
        for k in range(1, waypoint.ticks + 1):
            done = k / waypoint.ticks
            if index == 0:
                # Nothing is held yet and nothing is near, so joints go straight, which needs the least speed.
                joints.append(start_joints + _ease(done) * (first.joints - start_joints))
            else:
                between = (knots[index], knots[index + 1], velocities[index], velocities[index + 1])
                solution = ik.follow(_interpolate(*between, done, durations[index]), solution, _ITERATIONS)
                joints.append(solution.joints)
            moved = _ease(max(0.0, done - waypoint.fingers_from) / (1 - waypoint.fingers_from))
            gripper.append(before.gripper + moved * (waypoint.gripper - before.gripper))
            grip.append(before.grip + moved * (waypoint.grip - before.grip))
        before = waypoint
        position_error = max(position_error, solution.position_error)
        if index in (plan.grasp, plan.release):
            # The pinch frame's z axis points where the fingers do.
            leaned = max(leaned, math.pi - tilt((ik.pose_of(joints[-1]) @ T_pinch_in_object)[:3, :3]))
    last = joints[-1]
    for k in range(1, plan.settle_ticks + 1):
        joints.append(last + _ease(k / plan.settle_ticks) * (start_joints - last))
        gripper.append(gripper[-1])
        grip.append(grip[-1])

    path, opening = np.array(joints), np.array(gripper)
    return JointPath(
        joints=path,
        torques=dynamics.torques(path, opening, timing.tick),
        gripper=opening,
        grip=np.array(grip),
        magnet=tuple(plan.weld and tick in plan.phases.held for tick in range(len(opening))),
        tick=timing.tick,
        position_error=position_error,
        tilt=leaned,
    )


def stand_still(dynamics: ArmDynamics, stand: Stand, ticks: int, tick: float) -> JointPath:
    """An arm that holds its place for so many ticks of `tick` seconds."""
    path, opening = np.tile(stand.joints, (ticks + 1, 1)), np.full(ticks, stand.opening)
    torques = dynamics.torques(path, opening, tick)
    return JointPath(path, torques, opening, np.zeros(ticks), (False,) * ticks, tick, position_error=0.0, tilt=0.0)


def _ease(fraction: float) -> float:
    """The share of a way from 0 to 1 that is done at a share of the time, with minimum jerk."""
    u = fraction
    return u**3 * (10 - 15 * u + 6 * u**2)


def _knot_velocities(plan: Plan, knots: Sequence[Array], durations: Sequence[float]) -> list[Array]:
    """Linear velocity (3,) at each knot, m/s: zero where the motion stops, else along the line between neighbours."""
    velocities = [np.zeros(3)]
    for index, waypoint in enumerate(plan.waypoints, start=1):
        if waypoint.stop:
            velocities.append(np.zeros(3))
        else:
            around = durations[index - 1] + durations[index]
            velocities.append((knots[index + 1][:3, 3] - knots[index - 1][:3, 3]) / around)
    return velocities


def _interpolate(T0: Array, T1: Array, v0: Array, v1: Array, fraction: float, duration: float) -> Array:
    """A pose between two knots: quintic in position with the given end velocities (m/s), minimum jerk in rotation.

    Accelerations vanish at both ends, so the whole path's acceleration is continuous.
    """
    u, ease = fraction, _ease(fraction)
    leave = u - 6 * u**3 + 8 * u**4 - 3 * u**5
    arrive = -4 * u**3 + 7 * u**4 - 3 * u**5
    position = T0[:3, 3] + ease * (T1[:3, 3] - T0[:3, 3]) + duration * (leave * v0 + arrive * v1)
    return pose(position, interpolate_rotation(T0[:3, :3], T1[:3, :3], ease))
