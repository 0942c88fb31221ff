"""Forward kinematics of one bare arm, and inverse kinematics that says when a pose is out of reach."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from ..errors import SimulationError
from ..geometry.se3 import Array, pose
from .ik import IkSolution, IkSolver

# From a cold start the iteration may have to cross the workspace.
_ITERATIONS = 100

# From the wrist to the finger tips, m.
_HAND = 0.13


class ArmKinematics:
    """Where the hand is for given joints.

    Args:
        model: a bare arm (nq = 6), see `scene.robot.bare_arm`.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._data = mujoco.MjData(model)

    def T_grasp_in_base(self, joints: ArrayLike) -> Array:
        """Pose (4, 4) of `grasp_site` in the arm's base, with the arm at `joints` (6,) in rad."""
        return self.T_site_in_base(joints, "grasp_site")

    def T_site_in_base(self, joints: ArrayLike, name: str) -> Array:
        """Pose (4, 4) of one of the hand's sites in the arm's base, with the arm at `joints` (6,) in rad."""
        self._data.qpos[:] = np.asarray(joints, dtype=np.float64)
        mujoco.mj_kinematics(self._model, self._data)
        site = self._data.site(name)
        return pose(site.xpos, site.xmat.reshape(3, 3))


class OutOfReachError(SimulationError):
    """A pose that the arm does not reach.

    Attributes:
        nearest: the joints that come nearest, and what they lack.
    """

    def __init__(self, nearest: IkSolution, tolerance: Tolerance) -> None:
        turned = math.degrees(max(nearest.tilt_error, nearest.heading_error))
        super().__init__(
            f"out of the arm's reach: the nearest it gets is {nearest.position_error * 1000:.1f} mm and {turned:.1f} "
            f"deg away (at most {tolerance.position * 1000:g} mm and {math.degrees(tolerance.rotation):g} deg), with "
            f"the joints {np.array2string(nearest.joints, precision=3, suppress_small=True)}"
        )
        self.nearest = nearest


@dataclass(frozen=True)
class Tolerance:
    """By how much a pose may be missed, m and rad, the latter in tilt and in heading each."""

    position: float
    rotation: float

    def admits(self, solution: IkSolution) -> bool:
        """Whether a solution is near enough."""
        turned = max(solution.tilt_error, solution.heading_error)
        return solution.position_error <= self.position and turned <= self.rotation


def reach(
    solvers: Sequence[IkSolver], T_tool_in_world: Array, starts: Iterable[Array], tolerance: Tolerance
) -> IkSolution:
    """The first solution near enough, searched for from one start (6,) after the other.

    Args:
        solvers: each goes on from where the one before ended.

    Raises:
        OutOfReachError: none is; it has the nearest.
    """
    found: list[IkSolution] = []
    for start in starts:
        joints = start
        for solver in solvers:
            solution = solver.solve(T_tool_in_world, joints, _ITERATIONS)
            if tolerance.admits(solution):
                return solution
            joints = solution.joints
        found.append(solution)
    raise OutOfReachError(min(found, key=_miss), tolerance)


def _miss(solution: IkSolution) -> float:
    """How far a solution is off, the hand's length turning an angle into a distance."""
    return solution.position_error + _HAND * (solution.tilt_error + solution.heading_error)
