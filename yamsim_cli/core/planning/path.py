"""From a plan's waypoints to joint references, one a control tick."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..config.task import TaskConfig, Timing
from ..geometry.se3 import Array, interpolate_rotation, inverse, pose
from ..types import JointPath, Layout, Plan
from .dynamics import ArmDynamics
from .ik import IkSolution, IkSolver

# From a cold start the iteration may have to cross the workspace; along a path each tick starts next to its solution.
_COLD_ITERATIONS = 100
_WARM_ITERATIONS = 12

# The fingers begin to close, or to open, in the last part of the way to the grasp, or to the place: the hand never
# stands still to wait for them, and the weld lets go only once they are open.
_FINGERS_MOVE_FROM = 0.7


def best_plan(ik: IkSolver, task: TaskConfig, plans: Sequence[Plan], layout: Layout, T_base_in_world: Array) -> Plan:
    """The plan whose grasp and release the arm reaches best: position first, then the least tilt and turn."""
    start = np.array(task.start_joints)
    x, y = (inverse(T_base_in_world) @ layout.T_in_world[task.object.name])[:2, 3]
    start[0] += np.arctan2(y, x)

    def badness(plan: Plan) -> tuple[float, float]:
        ik.hold(plan.T_object_in_pinch)
        solutions = _solve_waypoints(ik, plan, start)
        key = (solutions[plan.grasp], solutions[plan.release])
        # To the millimetre: below that the two ways round are equally good.
        position = max(round(solution.position_error, 3) for solution in solutions)
        return position, max(solution.tilt_error + solution.heading_error for solution in key)

    return min(plans, key=badness)


def _solve_waypoints(ik: IkSolver, plan: Plan, start: Array) -> list[IkSolution]:
    solutions: list[IkSolution] = []
    for waypoint in plan.waypoints:
        solutions.append(ik.solve(waypoint.T_object_in_world, start, _COLD_ITERATIONS))
        start = solutions[-1].joints
    return solutions


def plan_path(ik: IkSolver, dynamics: ArmDynamics, plan: Plan, start_joints: Array, timing: Timing) -> JointPath:
    """Solve a plan tick by tick.

    Args:
        start_joints: the arm's joints (6,) at rest before the first tick, rad.

    Returns:
        The path; whether its errors are small enough is for the caller to say.
    """
    ik.hold(plan.T_object_in_pinch)
    ticks = timing.ticks_per_waypoint
    knots = [ik.pose_of(start_joints), *(waypoint.T_object_in_world for waypoint in plan.waypoints)]
    velocities = _knot_velocities(plan, knots, ticks * timing.tick)

    joints, gripper, magnet = [start_joints], [], []
    position_error, tilt = 0.0, 0.0
    for index, waypoint in enumerate(plan.waypoints):
        following = plan.waypoints[min(index + 1, len(plan.waypoints) - 1)]
        for k in range(1, ticks + 1):
            target = _interpolate(
                knots[index], knots[index + 1], velocities[index], velocities[index + 1], k / ticks, ticks * timing.tick
            )
            solution = ik.solve(target, joints[-1], _WARM_ITERATIONS)
            joints.append(solution.joints)
            early = index in (plan.grasp, plan.release) and k / ticks > _FINGERS_MOVE_FROM
            gripper.append(following.gripper if early else waypoint.gripper)
            magnet.append(plan.grasp < index <= plan.release)
        position_error = max(position_error, solution.position_error)
        if index in (plan.grasp, plan.release):
            tilt = max(tilt, solution.tilt_error)
    for _ in range(timing.settle_ticks):
        joints.append(joints[-1])
        gripper.append(gripper[-1])
        magnet.append(False)

    path, opening = np.array(joints), np.array(gripper)
    return JointPath(
        joints=path,
        torques=dynamics.torques(path, opening, timing.tick),
        gripper=opening,
        magnet=tuple(magnet),
        tick=timing.tick,
        position_error=position_error,
        tilt=tilt,
    )


def _knot_velocities(plan: Plan, knots: Sequence[Array], segment: float) -> list[Array]:
    """Linear velocity (3,) at each knot, m/s: zero where the motion stops, else along the chord of its neighbours."""
    velocities = [np.zeros(3)]
    for index, waypoint in enumerate(plan.waypoints, start=1):
        if waypoint.stop:
            velocities.append(np.zeros(3))
        else:
            velocities.append((knots[index + 1][:3, 3] - knots[index - 1][:3, 3]) / (2 * segment))
    return velocities


def _interpolate(T0: Array, T1: Array, v0: Array, v1: Array, fraction: float, segment: float) -> Array:
    """A pose between two knots: quintic in position with the given end velocities (m/s), minimum jerk in rotation.

    Accelerations vanish at both ends, so the whole path's acceleration is continuous.
    """
    u = fraction
    ease = u**3 * (10 - 15 * u + 6 * u**2)
    leave = u - 6 * u**3 + 8 * u**4 - 3 * u**5
    arrive = -4 * u**3 + 7 * u**4 - 3 * u**5
    position = T0[:3, 3] + ease * (T1[:3, 3] - T0[:3, 3]) + segment * (leave * v0 + arrive * v1)
    return pose(position, interpolate_rotation(T0[:3, :3], T1[:3, :3], ease))
