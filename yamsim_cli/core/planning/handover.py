"""Which way of handing an object over both arms can do, and the paths that do it."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..config.recording import RecordConfig
from ..config.things import GraspPoint
from ..geometry.se3 import Array
from ..scene.compiled import CompiledScene, SceneArm
from ..tasks.handover import LEFT, RIGHT, exchange, exchange_pose, giving_plan, taking_plan, wrist_turn
from ..tasks.plans import Hold
from ..types import JointPath, Layout, Plan
from .choice import lacking, near_enough, path_strain
from .clearance import Clearance
from .demonstration import ArmTools, Demonstration, start_stand
from .ik import IkSolution, IkSolver
from .path import plan_path

# From a cold start the iteration may have to cross the workspace.
_ITERATIONS = 100

# How far a hand may lean, in the order in which that is tried; and where the way from the right hand to the left one
# may head: straight to the left, or turned from that.
_LEANS = tuple(math.radians(angle) for angle in (15, 25, 5))
_HEADINGS = tuple(math.radians(angle) for angle in range(30, 151, 15))


@dataclass(frozen=True)
class _Half:
    """What one arm is to do, and what it makes of that.

    Attributes:
        heading: from the giving to the taking hand, in `world`, rad.
        path: plans the arm's path, once; one half goes with several others.
    """

    hold: Hold
    heading: float
    T_exchange: Array
    plan: Plan
    solutions: Sequence[IkSolution]
    path: Callable[[], JointPath]

    @property
    def badness(self) -> tuple[bool, float]:
        """Out of reach, and how much it lacks otherwise."""
        return not near_enough(self.plan, self.solutions), lacking(self.solutions)

    def at(self, name: str) -> tuple[float, ...]:
        """Joints and opening (7,) at a waypoint."""
        for waypoint, solution in zip(self.plan.waypoints, self.solutions, strict=True):
            if waypoint.name == name:
                return (*solution.joints, waypoint.gripper)
        raise KeyError(name)


_Badness = tuple[bool, bool, float]


class HandoverPlanner:
    """The right arm gives, the left one takes."""

    def __init__(self, config: RecordConfig, scene: CompiledScene, tools: Sequence[ArmTools]) -> None:
        self._task = config.task
        self._scene = scene
        self._tools = tools
        self._stand = start_stand(config)
        self._clearance = [Clearance(scene, arm, self._stand) for arm in range(len(scene.arms))]

    def plan(self, layout: Layout) -> Demonstration:
        """The first way in which both arms reach everything with ease and touch nothing, else the least bad one."""
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
                if not any(badness):
                    return found
        assert best is not None  # there is at least one way
        return best[1]

    def _giving(self, layout: Layout) -> Iterator[_Half]:
        """First those in which the wrist has to turn the object least on its way: a hand that leans outwards where it
        picks the object up then does so at the exchange too.
        """
        points, T_base = exchange(self._task).points, self._scene.arms[RIGHT].T_base_in_world
        ways = []
        for heading in _HEADINGS:
            for point, other in (points, points[::-1]):
                T_exchange = exchange_pose(self._task, layout, point, other, heading)
                turn = wrist_turn(layout.T_in_world[self._task.object.name], T_exchange, T_base)
                ways.append((abs(turn), point, T_exchange, heading))
        for _, point, T_exchange, heading in sorted(ways, key=lambda way: way[0]):
            yield from self._halves(RIGHT, giving_plan, layout, point, T_exchange, heading)

    def _taking(self, layout: Layout, giving: _Half) -> Iterator[_Half]:
        other = next(point for point in exchange(self._task).points if point != giving.hold.point)
        yield from self._halves(LEFT, taking_plan, layout, other, giving.T_exchange, giving.heading)

    def _halves(
        self,
        number: int,
        make: Callable[..., Plan],
        layout: Layout,
        point: GraspPoint,
        T_exchange: Array,
        heading: float,
    ) -> Iterator[_Half]:
        arm, ik = self._scene.arms[number], self._tools[number].ik
        for flipped in (False, True):
            for lean in _LEANS:
                hold = Hold(point, flipped, lean)
                plan = make(self._task, layout, arm.T_base_in_world, hold, T_exchange, heading)
                solutions = _solve(ik, plan, self._stand[number, :6])
                path = functools.cache(functools.partial(self._path, number, plan))
                yield _Half(hold, heading, T_exchange, plan, solutions, path)

    def _touched(self, layout: Layout, giving: _Half, taking: _Half) -> str | None:
        """What either arm would touch at its waypoints, the other one being where it is then."""
        rest = self._stand[LEFT]
        right = [rest, rest, rest, taking.at("pre-take"), taking.at("take"), taking.at("hold")]
        met, gone, home = giving.at("exchange"), giving.at("withdraw"), self._stand[RIGHT]
        left = [met, met, giving.at("give"), gone, home, home, home]
        return self._arm_touches(layout, RIGHT, giving, right) or self._arm_touches(layout, LEFT, taking, left)

    def _arm_touches(self, layout: Layout, arm: int, half: _Half, others: Sequence[Sequence[float]]) -> str | None:
        stands = []
        for other in others:
            stand = self._stand.copy()
            stand[1 - arm] = other
            stands.append(stand)
        return self._clearance[arm].touched(half.plan, half.solutions, layout, stands)

    def _paths(self, giving: _Half, taking: _Half, badness: _Badness) -> tuple[_Badness, Demonstration]:
        halves = {LEFT: taking, RIGHT: giving}
        paths = tuple(halves[k].path() for k in range(len(self._tools)))
        arms: Sequence[SceneArm] = self._scene.arms
        strain = sum(path_strain(arm, path) for arm, path in zip(arms, paths, strict=True))
        found = Demonstration(paths, max(path.position_error for path in paths), max(path.tilt for path in paths))
        return (badness[0], badness[1], round(badness[2] + strain, 2)), found

    def _path(self, number: int, plan: Plan) -> JointPath:
        tools = self._tools[number]
        return plan_path(tools.ik, tools.dynamics, plan, self._stand[number, :6], self._task.timing)


def _solve(ik: IkSolver, plan: Plan, start: Array) -> list[IkSolution]:
    ik.hold(plan.T_object_in_pinch)
    joints, solutions = np.array(start), list[IkSolution]()
    for waypoint in plan.waypoints:
        solutions.append(ik.solve(waypoint.T_object_in_world, joints, _ITERATIONS))
        joints = solutions[-1].joints
    return solutions
