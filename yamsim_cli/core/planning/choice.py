"""Which of the ways to hold the object the arm can do, and the path that does it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..config.recording import GraspKind
from ..config.task import TaskConfig
from ..config.things import GraspPoint
from ..geometry.se3 import Array
from ..scene.compiled import CompiledScene, SceneArm
from ..tasks.kinds import kind_of
from ..tasks.plans import Hold
from ..types import JointPath, Layout, Plan
from .clearance import Clearance
from .dynamics import ArmDynamics
from .ik import IkSolution, IkSolver
from .path import plan_path

# From a cold start the iteration may have to cross the workspace.
_ITERATIONS = 100

# A solution this near to its pose is it, m and rad.
_POSITION = 1e-3
_ROTATION = math.radians(1.0)

# How far the hand may lean, its fingers pointing outwards, in the order in which that is tried. A little suits the arm
# best everywhere; it needs the more, the farther away something lies or the higher it is carried; and some things stand
# in the way of a hand that leans far.
_LEANS = tuple(math.radians(angle) for angle in (15, 20, 10, 25, 5, 30, 0))

# How far joints should stay from their stops, rad; and the largest shares of the motors' speed and the drives' torque
# that a path should need.
_FREE = 0.15
_SPEED = 0.9
_TORQUE = 0.8


@dataclass(frozen=True)
class _Candidate:
    """A plan, what the arm makes of its waypoints, and what the hand would touch at them."""

    hold: Hold
    plan: Plan
    solutions: Sequence[IkSolution]
    touched: str | None

    @property
    def badness(self) -> tuple[bool, bool, float]:
        """Out of reach, in touch with something, and how much it lacks otherwise."""
        return not near_enough(self.plan, self.solutions), self.touched is not None, lacking(self.solutions)


def near_enough(plan: Plan, solutions: Sequence[IkSolution]) -> bool:
    """Whether the arm reaches a plan's waypoints."""
    # The grasp and the release have to be as planned; elsewhere the hand may lean a little more.
    key = (solutions[plan.grasp], solutions[plan.release])
    return (
        max(solution.position_error for solution in solutions) <= _POSITION
        and max(solution.tilt_error + solution.heading_error for solution in key) <= _ROTATION
    )


def lacking(solutions: Sequence[IkSolution]) -> float:
    """By how much solutions come too near to a joint's stop, or turn away from their poses, rad; 0 if they do not."""
    near = max(0.0, _FREE - min(solution.margin for solution in solutions))
    turned = max(solution.tilt_error + solution.heading_error for solution in solutions)
    return round(near + turned, 2)


def path_strain(arm: SceneArm, path: JointPath) -> float:
    """By how much a path needs more than an arm should give; 0 if it does not."""
    low, high = arm.joint_range.T
    # The start is the task's and not the path's.
    free = float(np.minimum(path.joints[1:] - low, high - path.joints[1:]).min())
    speed = float((np.abs(path.velocities) / arm.motor_speed).max())
    torque = float((np.abs(path.torques) / arm.most_torque).max())
    return max(0.0, _FREE - free) + max(0.0, speed - _SPEED) + max(0.0, torque - _TORQUE)


class PathChooser:
    """Plans attempts: for one arm of a scene, one task and kind of grasp.

    Args:
        arm: its number in the scene.
        stand: where the scene's arms stand otherwise, see `Clearance`.
    """

    def __init__(
        self,
        ik: IkSolver,
        dynamics: ArmDynamics,
        scene: CompiledScene,
        task: TaskConfig,
        grasp: GraspKind,
        arm: int = 0,
        stand: Array | None = None,
    ) -> None:
        self._ik = ik
        self._dynamics = dynamics
        self._clearance = Clearance(scene, arm, stand)
        self._arm = scene.arms[arm]
        self._task = task
        kind = kind_of(task).one_armed
        assert kind is not None  # any other kind has a planner of its own
        self._kind = kind
        self._grasp: GraspKind = grasp
        self._start = np.array(task.start_joints)
        self._widest = _widest(scene, self._arm)

    def choose(self, layout: Layout) -> tuple[Plan, JointPath]:
        """The first way to hold the object in which the arm reaches everything with ease and touches nothing, else the
        least bad; and the path.

        Tried are the object's grasp points in their order, at each of them the hand either way round, leaning more or
        less.
        """
        best: tuple[tuple[bool, bool, float], Plan, JointPath] | None = None
        for candidate in self._candidates(layout):
            if best is not None and candidate.badness >= best[0]:
                continue
            path = plan_path(self._ik, self._dynamics, candidate.plan, self._start, self._task.timing)
            *faults, lacking = candidate.badness
            badness = (faults[0], faults[1], round(lacking + path_strain(self._arm, path), 2))
            if best is None or badness < best[0]:
                best = badness, candidate.plan, path
            if not any(badness):
                break
        assert best is not None  # there is at least one point
        return best[1:]

    def _candidates(self, layout: Layout) -> Iterator[_Candidate]:
        for point in self._kind.grasp_points(self._task, self._grasp):
            for flipped in self._ways_round(layout, point):
                for lean in _LEANS:
                    yield self._candidate(layout, Hold(point, flipped, lean))

    def _ways_round(self, layout: Layout, point: GraspPoint) -> list[bool]:
        """Both ways round, the better one first. That is a matter of the last joint, however the hand leans."""
        margins = {}
        for flipped in (False, True):
            plan = self._plan(layout, Hold(point, flipped, _LEANS[0]))
            self._ik.hold(plan.T_object_in_pinch)
            solution = self._ik.solve(plan.waypoints[plan.grasp].T_object_in_world, self._start, _ITERATIONS)
            margins[flipped] = round(solution.margin - solution.tilt_error - solution.heading_error, 3)
        return sorted(margins, key=lambda flipped: -margins[flipped])

    def _candidate(self, layout: Layout, hold: Hold) -> _Candidate:
        plan = self._plan(layout, hold)
        self._ik.hold(plan.T_object_in_pinch)
        joints, solutions = self._start, list[IkSolution]()
        for waypoint in plan.waypoints:
            solutions.append(self._ik.solve(waypoint.T_object_in_world, joints, _ITERATIONS))
            joints = solutions[-1].joints
        return _Candidate(hold, plan, solutions, self._clearance.touched(plan, solutions, layout))

    def _plan(self, layout: Layout, hold: Hold) -> Plan:
        """The task's plan, the fingers as wide as it asks and no wider than they go."""
        plan = self._kind.make_plan(self._task, self._grasp, layout, self._arm.T_base_in_world, hold)
        waypoints = (replace(waypoint, gripper=min(waypoint.gripper, self._widest)) for waypoint in plan.waypoints)
        return replace(plan, waypoints=tuple(waypoints))


def _widest(scene: CompiledScene, arm: SceneArm) -> float:
    """How far each finger can open, m; its drive could be told to go farther."""
    joints = np.searchsorted(scene.model.jnt_qposadr, arm.gripper_qpos)
    ends = scene.model.jnt_range[joints] * arm.gripper_sign[:, None]
    return float(ends.max(axis=1).min())
