"""Chooses how the arm holds the object, and plans the path for that."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..config.recording import GraspKind
from ..config.task import TaskConfig
from ..config.things.thing import GraspPoint
from ..scene.compiled import CompiledScene, SceneArm
from ..tasks.kinds import kind_of
from ..tasks.plans import Hold
from ..types import JointPath, Layout, Plan, Stand
from .clearance import Clearance
from .dynamics import ArmDynamics
from .ik import IkSolution, IkSolver
from .path import plan_path

# Iterations of inverse kinematics that does not start near the solution, and may have to cross the workspace.
_ITERATIONS = 100

# Largest errors of a solution that counts as reaching its pose, m and rad.
_POSITION = 1e-3
_ROTATION = math.radians(1.0)

# Angles by which the hand may lean with its fingers pointing outwards, in the order in which they are tried. A small
# one suits the arm best everywhere. It needs larger ones for things that lie far away or are carried high. A hand that
# leans far may run into other things.
_LEANS = tuple(math.radians(angle) for angle in (15, 20, 10, 25, 5, 30, 0))

# Where the place itself tilts the hand, by how much more it leans: pads lie best on a wall when it leans no more.
_BESIDE = tuple(math.radians(angle) for angle in (0, 2, -2, 4, -4))

# How far joints should stay from their stops, rad.
_FREE = 0.15
# Largest shares of the motors' speed and of the drives' torque that a path should need.
_SPEED = 0.9
_TORQUE = 0.8


@dataclass(frozen=True)
class _Candidate:
    """A plan, the joints at its waypoints, and what the arm would touch there."""

    hold: Hold
    plan: Plan
    solutions: Sequence[IkSolution]
    touched: str | None

    @property
    def badness(self) -> tuple[bool, bool, float]:
        """Whether it is out of reach, whether it touches something, and how far it is from good otherwise."""
        return not near_enough(self.plan, self.solutions), self.touched is not None, lacking(self.solutions)


def near_enough(plan: Plan, solutions: Sequence[IkSolution]) -> bool:
    """Whether the arm reaches a plan's waypoints."""
    # Grasp and release have to be as planned. Elsewhere the hand may be turned a little.
    key = (solutions[plan.grasp], solutions[plan.release])
    return (
        max(solution.position_error for solution in solutions) <= _POSITION
        and max(solution.tilt_error + solution.heading_error for solution in key) <= _ROTATION
    )


def lacking(solutions: Sequence[IkSolution]) -> float:
    """How much nearer to a stop than allowed joints come, plus how far solutions are turned from their poses, rad."""
    near = max(0.0, _FREE - min(solution.margin for solution in solutions))
    turned = max(solution.tilt_error + solution.heading_error for solution in solutions)
    return round(near + turned, 2)


def path_strain(arm: SceneArm, path: JointPath) -> float:
    """By how much a path exceeds the limits that it should keep, summed up; 0 if it keeps them."""
    low, high = arm.joint_range.T
    # The start is given by the task, and so it does not count.
    free = float(np.minimum(path.joints[1:] - low, high - path.joints[1:]).min())
    speed = float((np.abs(path.velocities) / arm.motor_speed).max())
    torque = float((np.abs(path.torques) / arm.most_torque).max())
    return max(0.0, _FREE - free) + max(0.0, speed - _SPEED) + max(0.0, torque - _TORQUE)


def _leans(point: GraspPoint) -> tuple[float, ...]:
    return _LEANS if point.tilt_deg is None else _BESIDE


class PathChooser:
    """Plans attempts of one task with one kind of grasp, for one arm of a scene.

    Args:
        arm: its number in the scene.
        stands: where the scene's arms stand at the start.
    """

    def __init__(
        self,
        ik: IkSolver,
        dynamics: ArmDynamics,
        scene: CompiledScene,
        task: TaskConfig,
        grasp: GraspKind,
        arm: int,
        stands: Sequence[Stand],
    ) -> None:
        self._ik = ik
        self._dynamics = dynamics
        self._clearance = Clearance(scene, arm, stands)
        self._arm = scene.arms[arm]
        self._task = task
        kind = kind_of(task).one_armed
        assert kind is not None  # any other kind has a planner of its own
        self._kind = kind
        self._grasp: GraspKind = grasp
        self._start = stands[arm].joints
        assert self._arm.fingers is not None  # checked when the config was loaded
        # How far each finger can open; its drive could be told to go farther.
        self._widest = self._arm.fingers.stops[1]

    def choose(self, layout: Layout) -> tuple[Plan, JointPath]:
        """The plan and path of the first way to hold the object that has no fault, or else of the least bad way.

        Grasp points are tried in their order, each with the hand either way round and leaning by several angles. A way
        has no fault if the arm reaches all waypoints, touches nothing, and keeps away from its limits.
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
        for point in self._kind.grasp_points(self._task, self._grasp, layout, self._arm.T_base_in_world):
            for flipped in self._ways_round(layout, point):
                for lean in _leans(point):
                    yield self._candidate(layout, Hold(point, flipped, lean))

    def _ways_round(self, layout: Layout, point: GraspPoint) -> list[bool]:
        """Both ways round, the better one first. It depends on the last joint, and not on how the hand leans."""
        margins = {}
        for flipped in (False, True):
            plan = self._plan(layout, Hold(point, flipped, _leans(point)[0]))
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
        """The task's plan, with openings limited to what the fingers can do."""
        plan = self._kind.make_plan(self._task, self._grasp, layout, self._arm.T_base_in_world, hold)
        waypoints = (replace(waypoint, gripper=min(waypoint.gripper, self._widest)) for waypoint in plan.waypoints)
        return replace(plan, waypoints=tuple(waypoints))
