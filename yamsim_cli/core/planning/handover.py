"""Chooses how two arms hand an object over, and plans their paths for that."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..config.recording import GraspKind, RecordConfig
from ..config.things.thing import GraspPoint
from ..geometry.se3 import Array
from ..scene.compiled import CompiledScene, SceneArm
from ..tasks.handover import exchange, exchange_pose, giving_plan, phases, taking_plan, wrist_turn
from ..tasks.plans import Hold
from ..types import JointPath, Layout, Phases, Plan, Stand
from .choice import lacking, near_enough, path_strain
from .clearance import Clearance
from .demonstration import ArmTools, Demonstration, start_stands
from .ik import IkSolution, IkSolver
from .path import plan_path

# Iterations of inverse kinematics that does not start near the solution, and may have to cross the workspace.
_ITERATIONS = 100

# How far a hand may lean, in the order in which that is tried; and where the way from the giving hand to the taking one
# may head where that is the left one: straight to the left, or turned from that. To the right, the same mirrored.
# By friction hands lean away from each other, see `core.tasks.handover`.
_LEANS: Mapping[GraspKind, tuple[float, ...]] = {
    "weld": tuple(math.radians(angle) for angle in (15, 25, 5)),
    "contact": tuple(math.radians(angle) for angle in (35, 45, 25)),
}
_HEADINGS = tuple(math.radians(angle) for angle in range(30, 151, 15))

# How much a way may lack and yet be taken without a look at the others: two arms that lean seldom find one without any
# fault.
_ENOUGH: Mapping[GraspKind, float] = {"weld": 0.0, "contact": 0.1}


@dataclass(frozen=True)
class _Half:
    """One arm's part of a hand-over.

    Attributes:
        hold: how the hand holds the object.
        heading: heading of the line from the giving to the taking hand in `world`, rad.
        T_exchange: the object's pose (4, 4) at the exchange, in `world`.
        plan: what the hand does.
        solutions: joints at the plan's waypoints.
        path: gives the arm's path, which is planned once, since one half is combined with several others.
    """

    hold: Hold
    heading: float
    T_exchange: Array
    plan: Plan
    solutions: Sequence[IkSolution]
    path: Callable[[], JointPath]

    @property
    def badness(self) -> tuple[bool, float]:
        """Whether it is out of reach, and how far it is from good otherwise."""
        return not near_enough(self.plan, self.solutions), lacking(self.solutions)

    def at(self, name: str) -> Stand:
        """Where the arm stands at a waypoint."""
        for waypoint, solution in zip(self.plan.waypoints, self.solutions, strict=True):
            if waypoint.name == name:
                return Stand(solution.joints, waypoint.gripper)
        raise KeyError(name)


_Badness = tuple[bool, bool, float]


class HandoverPlanner:
    """One arm gives, the other takes."""

    def __init__(self, config: RecordConfig, scene: CompiledScene, tools: Sequence[ArmTools]) -> None:
        self._task, self._grasp = config.pair, config.grasp
        self._giver, self._taker = config.acting_scene_arms
        self._phases = phases(config.pair, config.grasp, self._giver, self._taker)
        # The scene's first arm is the left one.
        self._headings = [heading if self._giver > self._taker else -heading for heading in _HEADINGS]
        self._scene = scene
        self._tools = tools
        self._stands = start_stands(config)
        self._clearance = [Clearance(scene, arm, self._stands) for arm in range(len(scene.arms))]

    def plan(self, layout: Layout) -> Demonstration:
        """The paths of the first way to hand over that has no fault, or else of the least bad way."""
        best: tuple[_Badness, Demonstration] | None = None
        for giving in self._giving(layout):
            if best is not None and (giving.badness[0], False, giving.badness[1]) >= best[0]:
                continue
            for taking in self._taking(layout, giving):
                reach = max(giving.badness, taking.badness)
                touched = self._touched(layout, giving, taking) is not None
                if best is not None and (reach[0], touched, reach[1]) >= best[0]:
                    continue
                badness, found = self._paths(giving, taking, (reach[0], touched, reach[1]))
                if best is None or badness < best[0]:
                    best = badness, found
                if not any(badness[:2]) and badness[2] <= _ENOUGH[self._grasp]:
                    return found
        assert best is not None  # there is at least one way
        return best[1]

    def _giving(self, layout: Layout) -> Iterator[_Half]:
        """The right arm's parts. Those in which the wrist turns the object least on its way come first: a hand that
        leans outwards where it picks the object up then does so at the exchange, too.
        """
        points, T_base = exchange(self._task).points, self._scene.arms[self._giver].T_base_in_world
        ways = []
        for heading in self._headings:
            for point, other in (points, points[::-1]):
                T_exchange = exchange_pose(self._task, layout, point, other, heading)
                turn = wrist_turn(layout.T_in_world[self._task.object.name], T_exchange, T_base)
                ways.append((abs(turn), point, T_exchange, heading))
        for _, point, T_exchange, heading in sorted(ways, key=lambda way: way[0]):
            yield from self._halves(self._phases[0], giving_plan, layout, point, T_exchange, heading)

    def _taking(self, layout: Layout, giving: _Half) -> Iterator[_Half]:
        other = next(point for point in exchange(self._task).points if point != giving.hold.point)
        yield from self._halves(self._phases[1], taking_plan, layout, other, giving.T_exchange, giving.heading)

    def _halves(
        self,
        phase: Phases,
        make: Callable[..., Plan],
        layout: Layout,
        point: GraspPoint,
        T_exchange: Array,
        heading: float,
    ) -> Iterator[_Half]:
        number = phase.arm
        arm, ik = self._scene.arms[number], self._tools[number].ik
        for flipped in (False, True):
            for lean in _LEANS[self._grasp]:
                hold = Hold(point, flipped, lean)
                plan = make(self._task, self._grasp, layout, arm.T_base_in_world, hold, T_exchange, heading, phase)
                solutions = _solve(ik, plan, self._stands[number].joints)
                path = functools.cache(functools.partial(self._path, number, plan))
                yield _Half(hold, heading, T_exchange, plan, solutions, path)

    def _touched(self, layout: Layout, giving: _Half, taking: _Half) -> str | None:
        """What either arm would touch at its waypoints, the other one being where it is then."""
        rest, home = self._stands[self._taker], self._stands[self._giver]
        coming = {"exchange": "pre-take", "wait": "take", "give": "take", "withdraw": "hold"}
        leaving = {
            "pre-take": "exchange",
            "take": "exchange",
            "close": "exchange",
            "hold": "give",
            "arc-top": "withdraw",
        }
        takers = [taking.at(coming[w.name]) if w.name in coming else rest for w in giving.plan.waypoints]
        givers = [giving.at(leaving[w.name]) if w.name in leaving else home for w in taking.plan.waypoints]
        touched = self._arm_touches(layout, self._giver, giving, takers)
        return touched or self._arm_touches(layout, self._taker, taking, givers)

    def _arm_touches(self, layout: Layout, arm: int, half: _Half, others: Sequence[Stand]) -> str | None:
        elsewhere = [[other if k == 1 - arm else stand for k, stand in enumerate(self._stands)] for other in others]
        return self._clearance[arm].touched(half.plan, half.solutions, layout, elsewhere)

    def _paths(self, giving: _Half, taking: _Half, badness: _Badness) -> tuple[_Badness, Demonstration]:
        halves = {self._taker: taking, self._giver: giving}
        paths = tuple(halves[k].path() for k in range(len(self._tools)))
        arms: Sequence[SceneArm] = self._scene.arms
        strain = sum(path_strain(arm, path) for arm, path in zip(arms, paths, strict=True))
        found = Demonstration(paths, max(path.position_error for path in paths), max(path.tilt for path in paths))
        return (badness[0], badness[1], round(badness[2] + strain, 2)), found

    def _path(self, number: int, plan: Plan) -> JointPath:
        tools = self._tools[number]
        return plan_path(tools.ik, tools.dynamics, plan, self._stands[number].joints, self._task.timing)


def _solve(ik: IkSolver, plan: Plan, start: Array) -> list[IkSolution]:
    ik.hold(plan.T_object_in_pinch)
    joints, solutions = np.array(start), list[IkSolution]()
    for waypoint in plan.waypoints:
        solutions.append(ik.solve(waypoint.T_object_in_world, joints, _ITERATIONS))
        joints = solutions[-1].joints
    return solutions
