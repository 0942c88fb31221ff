from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from ...geometry.se3 import Array, invert_pose, pose, quat_from_rotation, rotation_from_vector
from .analytic_ik import find_analytic_ik
from .fast_ik import FastIkSolver

if TYPE_CHECKING:
    import mink

# Costs order the errors: position first, then heading, then tilt. An arm that must tilt its hand to reach a pose does
# so, and the position stays exact to a fraction of a millimetre.
_POSITION_COST = 10.0
_TILT_COST = 0.02
_HEADING_COST = 0.05
_DEFAULT_ROTATION_COSTS = (_TILT_COST, _TILT_COST, _HEADING_COST)

# Levenberg-Marquardt undoes a step that increases the cost, and tries a shorter one. Without damping, the iteration
# diverges for a nearly stretched arm, which is the case over a third of the table.
_DAMPING_START = 1e-5
_DAMPING_MIN = 1e-8
_DAMPING_MAX = 1e4  # the search ends above it
_DAMPING_DECREASE = 0.2  # after a successful step
_DAMPING_INCREASE = 10.0  # after a failed step

_QP_SOLVER = "daqp"
_CONVERGED_JOINT_STEP = 1e-5  # rad, of a joint in the last step
_CONVERGED_COST = 1e-14  # squared weighted error, as of 10 nm; rounding makes steps fail below this cost

_MAX_STEP = 0.35  # rad, of a joint between poses of a path; more may be another IK branch
_MAX_TRACKED_ROTATION_ERROR = 1e-3  # rad, at the previous pose: above it, an exact solution would be a jump

# rad. Nearer to a singular posture, as at the edge of the reach, exact joints on a path move fast and then turn back.
# The search slows them down: below 0.2 rad, its steps differ from exact ones.
_MIN_SINGULARITY_DISTANCE = 0.3

_FALLBACK_TILT_SHARE = (
    0.95  # share of the largest rotation error by which a hand tilts if the pose itself is out of reach
)

_REFINEMENT_ITERATIONS = 30  # from a solution of `FastIkSolver` to the exact pose


@dataclass(frozen=True)
class IkSolution:
    """Joints (dof,), rad, with the errors of the pose, m and rad, and the least distance to a joint limit, rad."""

    joints: Array
    position_error: float
    tilt_error: float
    heading_error: float
    joint_limit_margin: float


@dataclass(frozen=True)
class Tolerance:
    """Largest position error, m, and rotation error, rad, and least distance of joints from their limits, rad.

    With `allow_tilt`, the hand may tilt by up to `rotation` if the pose itself is out of reach.
    """

    position: float
    rotation: float
    joint_limit_margin: float = 0.05
    allow_tilt: bool = False

    def is_met_by(self, solution: IkSolution) -> bool:
        """Return whether a solution is within the tolerance."""
        return (
            solution.position_error <= self.position
            and solution.tilt_error + solution.heading_error <= self.rotation
            and solution.joint_limit_margin >= self.joint_limit_margin
        )


class IkSolver:
    """Inverse kinematics within the joint limits.

    An arm that `find_analytic_ik` accepts is solved exactly. For other arms, and for poses out of reach, a search
    iterates differential inverse kinematics to convergence, and the hand may tilt. Solutions bring the held frame, the
    site `tool`, to a target in `world`. At first it is the pinch frame. An error of 1 rad about its axes costs
    `rotation_costs` (3,), an error of 1 m costs 10.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        T_base_in_world: Array,
        rotation_costs: tuple[float, float, float] = _DEFAULT_ROTATION_COSTS,
    ) -> None:
        self._model = model
        self._T_base_in_world = T_base_in_world
        self._T_world_in_base = invert_pose(T_base_in_world)
        self._low, self._high = model.jnt_range.T.copy()
        self._analytic = find_analytic_ik(model)
        self._fast = FastIkSolver(model, T_base_in_world)
        self._rotation_costs = rotation_costs
        pinch = model.site("pinch_site")
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, pinch.quat)
        self._T_pinch_in_flange = pose(pinch.pos, rotation.reshape(3, 3))
        self.set_held_object_frame(np.eye(4))

    @property
    def has_analytic_ik(self) -> bool:
        """Whether the arm has analytic inverse kinematics: without an exact solution, a pose is out of reach."""
        return self._analytic is not None

    def set_held_object_frame(self, T_object_in_pinch: Array) -> None:
        """Set the held frame, which later calls bring to their targets."""
        T = self._T_pinch_in_flange @ T_object_in_pinch
        tool = self._model.site("tool")
        tool.pos[:] = T[:3, 3]
        tool.quat[:] = quat_from_rotation(T[:3, :3])
        self._T_flange_in_tool = invert_pose(T)

    def solve(self, T_tool_in_world: Array, start: Array, iterations: int) -> IkSolution:
        """Return a solution that brings the held frame to a pose, or the nearest one that a search finds.

        The exact solution nearest to joints `start` (dof,) is returned. `iterations` limits the search, which runs if
        there is no exact solution.
        """
        exact = self._solve_exact(T_tool_in_world, start)
        return self._solve_iteratively(T_tool_in_world, start, iterations) if exact is None else exact

    def solve_next(self, T_tool_in_world: Array, before: IkSolution, iterations: int) -> IkSolution:
        """Return a solution for the next pose of the held frame on a path, without a jump of a joint.

        `before` is the solution for the previous pose; `solution_at` gives the first one. `iterations` limits the
        search, which runs if no exact solution is near `before`.
        """
        start = before.joints
        if before.tilt_error + before.heading_error <= _MAX_TRACKED_ROTATION_ERROR and self._is_far_from_singularity(
            start
        ):
            exact = self._solve_exact(T_tool_in_world, start)
            if exact is not None and np.abs(exact.joints - start).max() <= _MAX_STEP:
                return exact
        return self._solve_iteratively(T_tool_in_world, start, iterations)

    def solution_at(self, joints: Array) -> IkSolution:
        """Return joints (dof,) as the exact solution for the pose that the held frame has at them."""
        return IkSolution(joints, 0.0, 0.0, 0.0, self._joint_limit_margin(joints))

    def solve_from(self, T_tool_in_world: Array, starts: Sequence[Array], tolerance: Tolerance) -> Array | None:
        """Return joints (dof,) that bring the held frame to a pose; None if none are found.

        The exact solution nearest to the first start (dof,) is returned. Without analytic inverse kinematics, a search
        runs from each start in turn until one succeeds.
        """
        if self._analytic is not None:
            exact = self._solve_exact(T_tool_in_world, starts[0], tolerance.joint_limit_margin)
            if exact is None and tolerance.allow_tilt:
                exact = self._solve_tilted(T_tool_in_world, starts[0], tolerance)
            return None if exact is None else exact.joints
        for start in starts:
            if (near := self._fast.solve(T_tool_in_world, start)) is not None:
                solution = self._solve_iteratively(T_tool_in_world, near, _REFINEMENT_ITERATIONS)
                if tolerance.is_met_by(solution):
                    return solution.joints
        return None

    def may_be_reachable(self, T_tool_in_world: Array, tolerance: Tolerance) -> Array:
        """Return a flag (n,) for each pose (n, 4, 4). False: `solve_from` cannot reach the pose without tilt."""
        if self._analytic is None:
            return np.ones(len(T_tool_in_world), bool)
        T_flange_in_base = self._T_world_in_base @ T_tool_in_world @ self._T_flange_in_tool
        return self._analytic.may_be_reachable(T_flange_in_base, tolerance.joint_limit_margin)

    def _solve_exact(self, T_tool_in_world: Array, start: Array, margin: float = 0.0) -> IkSolution | None:
        if self._analytic is None:
            return None
        T_flange_in_base = self._T_world_in_base @ T_tool_in_world @ self._T_flange_in_tool
        found = self._analytic.all_solutions(T_flange_in_base)
        if margin > 0.0 and len(found):
            found = found[np.minimum(found - self._low, self._high - found).min(axis=1) >= margin]
        if not len(found):
            return None
        return self.solution_at(found[0] if len(found) == 1 else self._analytic.nearest_solution(found, start))

    def _solve_tilted(self, T_tool_in_world: Array, start: Array, tolerance: Tolerance) -> IkSolution | None:
        """Return an exact solution for a pose tilted by about the rotation tolerance."""
        T_tilted = T_tool_in_world @ _tilt_rotations(_FALLBACK_TILT_SHARE * tolerance.rotation)
        for k in np.flatnonzero(self.may_be_reachable(T_tilted, tolerance)):
            if (found := self._solve_exact(T_tilted[k], start, tolerance.joint_limit_margin)) is not None:
                return found
        return None

    def _is_far_from_singularity(self, joints: Array) -> bool:
        return (
            self._analytic is not None and self._analytic.distance_from_singularity(joints) >= _MIN_SINGULARITY_DISTANCE
        )

    def _joint_limit_margin(self, joints: Array) -> float:
        return float(np.minimum(joints - self._low, self._high - joints).min())

    @functools.cached_property
    def _search(self) -> tuple[mink.Configuration, list[mink.Limit], mink.FrameTask]:
        import mink  # takes 0.2 s, which a process that plans no motion saves

        task = mink.FrameTask("tool", "site", _POSITION_COST, np.array(self._rotation_costs))
        return mink.Configuration(self._model), [mink.ConfigurationLimit(self._model)], task

    def _solve_iteratively(self, T_tool_in_world: Array, start: Array, iterations: int) -> IkSolution:
        import mink

        configuration, limits, task = self._search
        configuration.update(start)
        task.set_target(mink.SE3.from_matrix(self._T_world_in_base @ T_tool_in_world))
        error = task.compute_error(configuration)
        cost, damping = _weighted_cost(task, error), _DAMPING_START
        for _ in range(iterations):
            if cost < _CONVERGED_COST:
                break
            try:
                # For a step of one second, the velocity equals the change of the joints.
                change = mink.solve_ik(configuration, [task], 1.0, _QP_SOLVER, damping=damping, limits=limits)
            except mink.NoSolutionFound:
                # The solver fails for targets that are too far away; a shorter step may succeed.
                damping *= _DAMPING_INCREASE
                if damping > _DAMPING_MAX:
                    break
                continue
            before = configuration.q
            configuration.integrate_inplace(change, 1.0)
            new_error = task.compute_error(configuration)
            new_cost = _weighted_cost(task, new_error)
            if new_cost > cost:
                configuration.update(before)
                damping *= _DAMPING_INCREASE
                if damping > _DAMPING_MAX:
                    break
                continue
            error, cost, damping = new_error, new_cost, max(damping * _DAMPING_DECREASE, _DAMPING_MIN)
            if np.abs(change).max() < _CONVERGED_JOINT_STEP:
                break
        joints = configuration.q
        return IkSolution(
            joints=joints,
            position_error=float(np.linalg.norm(error[:3])),
            tilt_error=math.hypot(error[3], error[4]),
            heading_error=abs(float(error[5])),
            joint_limit_margin=self._joint_limit_margin(joints),
        )

    def forward_kinematics(self, joints: Array) -> Array:
        """Return the pose of the held frame in `world` at joints (dof,), rad."""
        configuration = self._search[0]
        configuration.update(joints)
        T: Array = configuration.get_transform_frame_to_world("tool", "site").as_matrix()
        return self._T_base_in_world @ T


def _weighted_cost(task: mink.FrameTask, error: Array) -> float:
    weighted = task.cost * error
    return float(weighted @ weighted)


@functools.cache
def _tilt_rotations(angle: float) -> Array:
    """Return rotations (4, 4, 4) by an angle about the x and y axes, in both directions."""
    axes = np.array([(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)])
    return np.array([pose(rotation=rotation_from_vector(angle * axis)) for axis in axes])
