"""Inverse kinematics of one bare arm. No other module knows mink."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mink
import mujoco
import numpy as np

from ..geometry.se3 import Array, inverse, pose, quat_from_rotation

# The position has priority. Orientation follows as far as the arm can, first heading and then tilt. Where the arm has
# to lean outwards to reach a place it does so, and the position stays exact to a fraction of a millimetre.
_POSITION_COST = 10.0
_TILT_COST = 0.02
_HEADING_COST = 0.05
_FOLLOWING = (_TILT_COST, _TILT_COST, _HEADING_COST)

# Levenberg-Marquardt: a step that increases the cost is taken back, and a shorter one is tried. Without that, the
# iteration diverges where the arm is nearly stretched out, which is over a third of the table.
_DAMPING_START = 1e-5
_DAMPING_MIN = 1e-8
_DAMPING_MAX = 1e4
_ACCEPTED = 0.2
_REJECTED = 10.0

_SOLVER = "daqp"
_CONVERGED = 1e-5

# Cost at which the iteration ends: 10 nm and a thousandth of a degree. From there on, rounding makes steps fail.
_EXACT = 1e-14


@dataclass(frozen=True)
class IkSolution:
    """Joints (dof,) in rad; what is left of the error, position in m, tilt and heading in rad; and how far the joint
    that is nearest to one of its stops is from it, rad.
    """

    joints: Array
    position_error: float
    tilt_error: float
    heading_error: float
    margin: float


class IkSolver:
    """Differential inverse kinematics, iterated to convergence, within the joint limits.

    Args:
        model: a bare arm with the sites `pinch_site` and `tool`, see `scene.robot.bare_arm`.
        T_base_in_world: pose (4, 4) of its base; targets are given in `world`.
        rotation_costs: costs (3,) of an error of 1 rad about the held frame's axes, where 1 m costs 10.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        T_base_in_world: Array,
        rotation_costs: tuple[float, float, float] = _FOLLOWING,
    ) -> None:
        self._model = model
        self._T_base_in_world = T_base_in_world
        self._T_world_in_base = inverse(T_base_in_world)
        self._configuration = mink.Configuration(model)
        self._limits = [mink.ConfigurationLimit(model)]
        self._task = mink.FrameTask("tool", "site", _POSITION_COST, np.array(rotation_costs))
        pinch = model.site("pinch_site")
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, pinch.quat)
        self._T_pinch_in_flange = pose(pinch.pos, rotation.reshape(3, 3))

    def hold(self, T_object_in_pinch: Array) -> None:
        """Solve from now on for the frame of an object held at this pose (4, 4) in the pinch frame."""
        T = self._T_pinch_in_flange @ T_object_in_pinch
        tool = self._model.site("tool")
        tool.pos[:] = T[:3, 3]
        tool.quat[:] = quat_from_rotation(T[:3, :3])

    def solve(self, T_tool_in_world: Array, start: Array, iterations: int) -> IkSolution:
        """Bring the held frame to a pose (4, 4), from joints `start` (dof,), in at most `iterations` steps."""
        configuration, task = self._configuration, self._task
        configuration.update(start)
        task.set_target(mink.SE3.from_matrix(self._T_world_in_base @ T_tool_in_world))
        error = task.compute_error(configuration)
        cost, damping = self._cost(error), _DAMPING_START
        for _ in range(iterations):
            if cost < _EXACT:
                break
            try:
                # For a step of one second, the velocity equals the change of the joints.
                change = mink.solve_ik(configuration, [task], 1.0, _SOLVER, damping=damping, limits=self._limits)
            except mink.NoSolutionFound:
                # The target is so far away that the solver fails for a step towards it. A shorter step may work.
                damping *= _REJECTED
                if damping > _DAMPING_MAX:
                    break
                continue
            before = configuration.q
            configuration.integrate_inplace(change, 1.0)
            new_error = task.compute_error(configuration)
            new_cost = self._cost(new_error)
            if new_cost > cost:
                configuration.update(before)
                damping *= _REJECTED
                if damping > _DAMPING_MAX:
                    break
                continue
            error, cost, damping = new_error, new_cost, max(damping * _ACCEPTED, _DAMPING_MIN)
            if np.abs(change).max() < _CONVERGED:
                break
        joints = configuration.q
        low, high = self._model.jnt_range.T
        return IkSolution(
            joints=joints,
            position_error=float(np.linalg.norm(error[:3])),
            tilt_error=math.hypot(error[3], error[4]),
            heading_error=abs(float(error[5])),
            margin=float(np.minimum(joints - low, high - joints).min()),
        )

    def pose_of(self, joints: Array) -> Array:
        """Where the held frame is (4, 4) in `world` with the arm at `joints` (dof,)."""
        self._configuration.update(joints)
        T: Array = self._configuration.get_transform_frame_to_world("tool", "site").as_matrix()
        return self._T_base_in_world @ T

    def _cost(self, error: Array) -> float:
        weighted = self._task.cost * error
        return float(weighted @ weighted)
