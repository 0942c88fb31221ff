from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from ...errors import SimulationError
from ...geometry.se3 import Array, invert_pose, pose, rotation_vector
from .analytic_ik import HAND_LENGTH
from .ik import IkSolver

_ITERATIONS = 100  # of a search, which may start far from the pose


class ArmKinematics:
    """Forward kinematics of a `scene.arm_model.kinematic_model`."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._data = mujoco.MjData(model)

    def T_grasp_in_base(self, joints: ArrayLike) -> Array:
        """Return the pose of `grasp_site` in the arm's base at joints (dof,), rad."""
        return self.T_site_in_base(joints, "grasp_site")

    def T_site_in_base(self, joints: ArrayLike, name: str) -> Array:
        """Return the pose of a site of the hand in the arm's base at joints (dof,), rad."""
        self._data.qpos[:] = np.asarray(joints, dtype=np.float64)
        mujoco.mj_kinematics(self._model, self._data)
        site = self._data.site(name)
        return pose(site.xpos, site.xmat.reshape(3, 3))

    def T_site_in_pinch(self, name: str) -> Array:
        """Return the pose of a site of the hand in the frame of `pinch_site`, which no joint changes."""
        joints = np.zeros(self._model.nq)
        return invert_pose(self.T_site_in_base(joints, "pinch_site")) @ self.T_site_in_base(joints, name)


@dataclass(frozen=True)
class IkResult:
    """Joints (dof,), rad, and the errors of their pose, m and rad."""

    joints: Array
    position_error: float
    rotation_error: float

    @property
    def total_error(self) -> float:
        """The total error, m; the rotation error counts as the distance that it causes at the fingertips."""
        return self.position_error + HAND_LENGTH * self.rotation_error


class OutOfReachError(SimulationError):
    """The arm does not reach a pose; `nearest` has the smallest total error."""

    def __init__(self, nearest: IkResult, position_tolerance: float, rotation_tolerance: float) -> None:
        super().__init__(
            f"out of the arm's reach: the nearest pose is {nearest.position_error * 1000:.1f} mm and "
            f"{math.degrees(nearest.rotation_error):.1f} deg away (at most {position_tolerance * 1000:g} mm and "
            f"{math.degrees(rotation_tolerance):.3g} deg), with the joints "
            f"{np.array2string(nearest.joints, precision=3, suppress_small=True, separator=', ')}"
        )
        self.nearest = nearest


def solve_ik_or_raise(
    solvers: Sequence[IkSolver],
    T_tool_in_world: Array,
    starts: Iterable[Array],
    position_tolerance: float,
    rotation_tolerance: float,
) -> IkResult:
    """Return joints that bring the solvers' frame to a pose, by a search from each start (dof,) in turn.

    Each solver starts from the previous solver's result. Tolerances are in m and rad. If no joints are within them,
    `OutOfReachError` holds the nearest ones.
    """
    nearest: IkResult | None = None
    for start in starts:
        joints = start
        for solver in solvers:
            joints = solver.solve(T_tool_in_world, joints, _ITERATIONS).joints
            T = solver.forward_kinematics(joints)
            found = IkResult(
                joints,
                float(np.linalg.norm(T[:3, 3] - T_tool_in_world[:3, 3])),
                float(np.linalg.norm(rotation_vector(T[:3, :3].T @ T_tool_in_world[:3, :3]))),
            )
            if found.position_error <= position_tolerance and found.rotation_error <= rotation_tolerance:
                return found
        nearest = found if nearest is None or found.total_error < nearest.total_error else nearest
    assert nearest is not None  # `starts` is not empty
    raise OutOfReachError(nearest, position_tolerance, rotation_tolerance)
