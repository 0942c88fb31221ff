"""Scoop loose pieces out of a dish into a container, by a spoon or a measuring cup."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import FiniteFloat

from ..core.attempt_data import FailureCause
from ..core.config.goals.role_assignment import RoleAssignment
from ..core.config.goals.world import TABLE
from ..core.config.program_task import ProgramTask
from ..core.expert.planning.collision_checker import AttachedObject
from ..core.expert.skills.common_motions import release_and_retreat, rest_segment
from ..core.expert.skills.hand import Hand
from ..core.expert.skills.pick import Pick, ReachableGrasp, summarize_reasons
from ..core.expert.skills.planning_context import MotionSegment, PlanningContext, SkillFailedError
from ..core.expert.skills.skill import Skill, find_holding_hand
from ..core.files.documents.units import QuantityBounds
from ..core.geometry.se3 import Array, invert_pose, rotation_from_vector, rotation_vector
from .held_pieces import LoosePieces, fault_of_pieces, fault_of_shape
from .scoop_strokes import (
    ScoopTool,
    half_length,
    is_free_step,
    pieces_on_spoon,
    plan_knots,
    plan_laying_down,
    plan_release,
    stroke_heading,
    tool_grasps,
    tool_of,
)
from .tilting import TICKS, HeldSource, Tilt, reachable_grasps, straight_tilt

_LIFT = 0.05  # m, straight up after grasping the tool: over the side walls of the dish, of up to 36 mm
_LAYING_CLEARANCE = 0.01  # m, by which each finger opens to lay the tool down; no other value is recorded
# rad, largest change of a joint in an action of a stroke or on the way. 1.0 with a spoon was tried only together with
# the pile of a cup, and brought less.
_SPOON_JOINT_STEP, _CUP_JOINT_STEP = 0.65, 1.0
# m, distances of a stroke from the middle of the dish, in the order of preference at equal scores: the dish of a spoon
# is 144 mm wide inside. The dish of a cup has room for the first only.
_ASIDE = (0.0, 0.008, -0.008, 0.016, -0.016, 0.024, -0.024, 0.034, -0.034, 0.045, -0.045)
_AHEAD = 0.0  # m from the middle of the dish along the heading; pieces beyond it count for a stroke
_BEHIND = -0.03  # m from the middle of the dish along the heading; pieces before it hinder a tool that goes down there
_FAILED_COST = 6  # pieces, by which the score is less for a line on which a stroke brought nothing: it would fail again
_SPOON_STEP = math.radians(45)  # rad, of a spoon's tilt in an action; no other value is recorded
_POUR_STEP = math.radians(30)  # rad, of a cup's tilt in an action; no other value is recorded
# rad: the tilt up to which few pieces slide out of a cup, and the step beyond it if only a part is to leave. Pieces
# slide from 101 degrees on, or earlier if the cup has turned in the hand. With 85 and 5 degrees, up to 9 pieces slid
# out in an action.
_SLIDING, _SLOW_STEP = math.radians(90), math.radians(3)
# Mass of the pieces that a cup's stroke passes, over the mass that is missing: a part of them stays in the dish. With
# 1.0, a stroke brought 0.5 to 0.7 of what was missing.
_PASSED = 1.6
_LEAST_GRAMS = 40.0  # g, least mass for which a cup's stroke is planned: shorter strokes brought nothing
_FULL_SHARE = 0.7  # share of the tolerance by which a tool may hold too much and still tilt by large steps
_MAX_WAITS = 2  # actions in which the tool waits at its largest tilt, for pieces that slide slowly
# Shares of a way at which the tool's pose is set: thirds, and for an empty cup the middle.
_WAY_SHARES, _EMPTY_WAY_SHARES = (0.33, 0.67), (0.5,)
# m, over the higher end of a way, in the order tried: a search instead takes 7 to 10 actions, and this way 2 to 4
_WAY_RISES = (0.0, 0.04, 0.08)
_MAX_SCOOPS = 14  # scoops in all: more than fit in the benchmark's 120 actions, of which one takes 8 or more
_MAX_EMPTY = 4  # scoops in a row that bring nothing, after which the expert gives up


@dataclass(frozen=True)
class _Stroke:
    """A stroke: joints (n, dof) of its poses, the tool's poses (4, 4), its heading in `world`, rad, and its line.

    A line is a distance of `_ASIDE`, which stays when a stroke pushes the dish.
    """

    joints: Array
    poses: list[Array]
    heading: float
    line: float


class _NoMotionError(SkillFailedError):
    """No stroke or no tilt is possible with the tool as it lies in the hand, where it turns little by little."""


class Scoop(Skill):
    """Scoop `grams` (g) of the loose pieces in `source` into another object with a `tool`, within `tolerance` (g)."""

    ROLES: ClassVar[tuple[str, ...]] = ("tool", "source", "into")
    REQUIRES_HELD_OBJECT: ClassVar[bool | None] = False
    LEAVES_OBJECT_HELD: ClassVar[bool | None] = True
    TYPICAL_SECONDS: ClassVar[float] = 16.0
    tool: str
    source: str
    into: str
    grams: Annotated[FiniteFloat, QuantityBounds("g", 0, 1000)]
    tolerance: Annotated[FiniteFloat, QuantityBounds("g", 0, 1000)]

    def task_fault(self, task: ProgramTask) -> tuple[str, str] | None:
        """Check that the source is a dish with loose pieces, and that the tool is cutlery or a cup."""
        return (
            fault_of_pieces(task, "source", self.source)
            or fault_of_shape(task, "source", self.source, ("container",))
            or fault_of_shape(task, "tool", self.tool, ("cutlery", "vessel"))
        )

    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """Do nothing if the container holds enough already; see `Skill.run`."""
        tool, source, into = (roles.object_of(role) for role in (self.tool, self.source, self.into))
        pieces = LoosePieces(context, source, tool)
        job = _Job(context, tool, source, into, pieces)
        missing = self.grams - pieces.grams_in(into)
        if abs(missing) <= self.tolerance:
            return
        T_start, configs, empty = context.world.pose(tool), context.object_configs, 0
        try:
            for _ in range(_MAX_SCOOPS):
                missing = self.grams - pieces.grams_in(into)
                if missing <= self.tolerance or empty == _MAX_EMPTY:
                    break
                yield from self._take(context, job)
                moved = pieces.grams_in(into)
                try:
                    yield from job.scoop_once(missing, self.tolerance)
                except _NoMotionError:
                    yield from job.lay_down(T_start)
                empty = 0 if pieces.grams_in(into) > moved else empty + 1
        finally:
            context.object_configs = configs
        missing = self.grams - pieces.grams_in(into)
        if abs(missing) > self.tolerance:
            text = f"{missing:.0f} g are missing in" if missing > 0 else f"{-missing:.0f} g too much are in"
            raise SkillFailedError(FailureCause.GOAL, f"{text} the {into}")

    def _take(self, context: PlanningContext, job: _Job) -> Iterator[MotionSegment]:
        """Yield the motions that grasp the tool, unless a hand holds it."""
        hand = find_holding_hand(context, job.tool_name)
        if hand is None:
            hand, grasp = self._find_grasp(context, job)
            yield from Pick(thing=self.tool, lift=_LIFT).grasp_and_lift(context, hand, job.tool_name, grasp)
        held = context.measure_held_object(hand)
        job.use(hand, tool_of(context.object_configs[job.tool_name], invert_pose(held.T_thing_in_pinch)))

    def _find_grasp(self, context: PlanningContext, job: _Job) -> tuple[Hand, ReachableGrasp]:
        """Return the hand and the first grasp with which a stroke and a tilt over the container are possible."""
        picker, reasons = Pick(thing=self.tool, lift=_LIFT), Counter[str]()
        config = context.object_configs[job.tool_name]
        candidates = list(tool_grasps(config))
        for hand, found in reachable_grasps(context, picker, job.tool_name, candidates, reasons):
            job.use(hand, tool_of(config, found.candidate.T_pinch_in_thing))
            T = invert_pose(found.candidate.T_pinch_in_thing)
            why = job.find_infeasibility(T, found.grasp_joints, found.candidate.opening)
            if why is None:
                return hand, found
            reasons[why] += 1
        why = summarize_reasons(reasons) or "no hand is free"
        raise SkillFailedError(FailureCause.UNREACHABLE, f"no grasp to scoop with the {job.tool_name}: {why}")


class _Job:
    """Scooping with a tool in a hand."""

    def __init__(self, context: PlanningContext, tool: str, source: str, into: str, pieces: LoosePieces) -> None:
        self.context, self.tool_name, self.source, self.into, self.pieces = context, tool, source, into, pieces
        self.hand: Hand
        self.tool: ScoopTool
        self.failed: set[float] = set()  # lines of strokes that brought nothing since the last that did

    def use(self, hand: Hand, tool: ScoopTool | None) -> None:
        """Set the hand and its tool."""
        assert tool is not None, "a spoon or a cup scoops"
        self.hand, self.tool = hand, tool

    def find_infeasibility(self, T_thing_in_pinch: Array, joints: Array, opening: float) -> str | None:
        """Return why a grasp does not allow to scoop, or None. The tool's pose is (4, 4), the hand's joints (dof,)."""
        stroke = self.best_stroke(T_thing_in_pinch, joints, opening)
        if stroke is None:
            return f"the {self.hand.side} arm cannot move the {self.tool_name} through the {self.source}"
        if self.release(T_thing_in_pinch, stroke.joints[-1], opening, stroke.heading) is None:
            return f"the {self.hand.side} arm cannot tilt the {self.tool_name} over the {self.into}"
        return None

    def best_stroke(
        self, T_thing_in_pinch: Array, joints: Array, opening: float, grams: float = math.inf
    ) -> _Stroke | None:
        """Return the free stroke with the best score: pieces ahead, minus pieces where the tool goes down.

        A cup's stroke ends where the pieces that it has passed suffice for `grams`, g.
        """
        context = self.context
        load = AttachedObject(self.tool_name, T_thing_in_pinch, (self.source,))
        T_dish, dish = context.world.pose(self.source), context.object_configs[self.source]
        off = (self.pieces.centres - T_dish[:3, 3])[self.context.world.points_inside(self.source, self.pieces.centres)]
        heading, options = stroke_heading(T_dish), []
        ahead = np.array((math.cos(heading), math.sin(heading), 0.0))
        along, left = off @ ahead, off @ np.array((-ahead[1], ahead[0], 0.0))
        # Pieces that a stroke has to pass. A spoon always moves along the whole dish.
        needed = math.inf if self.tool.is_spoon else _PASSED * grams / self.pieces.grams_each
        for aside in _ASIDE:
            if not self.tool.fits(dish, aside):
                continue
            near = np.abs(left - aside) < self.tool.swath_half_width
            score = int((near & (along > _AHEAD)).sum()) - int((near & (along < _BEHIND)).sum())
            score -= _FAILED_COST * (aside in self.failed)
            # A stroke passes no pieces behind the place where the tool goes down.
            passed = np.sort(along[near & (along > half_length(dish) + self.tool.entry)])
            before = 0.0
            if needed <= len(passed) - 1:
                before = max(0.0, half_length(dish) - passed[math.ceil(needed)])
            options.append((score, aside, before))
        options.sort(key=lambda one: (-one[0], abs(one[1])))
        for _, aside, before in options:
            poses = self.tool.stroke(dish, T_dish, heading, aside, before)
            rows = plan_knots(context, self.hand, opening, load, poses, joints)
            if len(rows) == len(poses):
                return _Stroke(rows, poses, heading, aside)
        return None

    def release(self, T_thing_in_pinch: Array, joints: Array, opening: float, heading: float) -> Tilt | None:
        """Return the motion that tilts the tool over the container, from joints (dof,); None if there is none."""
        load = AttachedObject(self.tool_name, T_thing_in_pinch)
        source = HeldSource(self.hand, load, joints, opening, self.pieces.length)
        return plan_release(self.context, source, self.tool, self.into, heading)

    def scoop_once(self, missing: float, tolerance: float) -> Iterator[MotionSegment]:
        """Yield the motions of one scoop, which brings `missing` g at most, give or take `tolerance`, g."""
        context, hand = self.context, self.hand
        held = context.measure_held_object(hand)
        T = held.T_thing_in_pinch
        stroke = self.best_stroke(T, hand.joints, hand.opening, max(missing, _LEAST_GRAMS))
        if stroke is None:
            raise _NoMotionError(FailureCause.UNREACHABLE, f"no free stroke of the {self.tool_name}")
        yield from self.travel(stroke.joints[0])
        yield from self.sweep(stroke)
        held = context.measure_held_object(hand)
        if not self.carried():
            self.failed.add(stroke.line)
            return
        self.failed.clear()
        tilt = self.release(held.T_thing_in_pinch, hand.joints, hand.opening, stroke.heading)
        if tilt is None:
            raise _NoMotionError(FailureCause.UNREACHABLE, f"no way to tilt the {self.tool_name} over the {self.into}")
        yield from self.travel(tilt.joints[0])
        least = self.pieces.grams_in(self.into) + missing - tolerance  # g in the container that suffice
        too_much = self.carried() > missing + _FULL_SHARE * tolerance
        yield from self.tilt(tilt, lambda: self.carried() == 0 or self.pieces.grams_in(self.into) >= least, too_much)

    def sweep(self, stroke: _Stroke) -> Iterator[MotionSegment]:
        """Yield the motions of a stroke after its first pose.

        Pieces turn a cup in the hand, so each of its motions is planned for the cup as it lies in the hand then.
        """
        if self.tool.is_spoon:
            yield from self.follow(stroke.joints[1:])
            return
        context, hand = self.context, self.hand
        for planned, T_tool in zip(stroke.joints[1:], stroke.poses[1:], strict=True):
            held = context.measure_held_object(hand)
            load = AttachedObject(self.tool_name, held.T_thing_in_pinch, (self.source,))
            joints = hand.solve_ik(T_tool @ invert_pose(held.T_thing_in_pinch), (hand.joints, planned))
            if joints is None or not is_free_step(context, hand, hand.opening, load, hand.joints, joints):
                joints = planned
            yield from self.follow(joints[None])

    def lay_down(self, T_start: Array) -> Iterator[MotionSegment]:
        """Yield the motions that lay the tool down near its first pose (4, 4), for another grasp."""
        context, hand = self.context, self.hand
        held = hand.held_object
        assert held is not None
        load = AttachedObject(self.tool_name, held.T_thing_in_pinch, (TABLE,))
        found = plan_laying_down(context, hand, load, T_start)
        if found is None:
            raise SkillFailedError(FailureCause.UNREACHABLE, f"no way to lay the {self.tool_name} down")
        yield from self.travel(found[0])
        yield from self.follow(np.array(found[1:]))
        yield from release_and_retreat(context, hand, _LAYING_CLEARANCE)
        yield rest_segment(context)

    def carried(self) -> float:
        """Return the mass of the pieces on or in the tool, g."""
        if not self.tool.is_spoon:
            return self.pieces.grams_in(self.tool_name)
        T_spoon = self.context.world.pose(self.tool_name)
        return self.pieces.grams(pieces_on_spoon(T_spoon, self.pieces.centres))

    def weigh(self) -> None:
        """Let the planning context know the mass of a cup with the pieces in it now; a spoon has no interior."""
        if not self.tool.is_spoon:
            self.pieces.weigh()

    def tilt(self, tilt: Tilt, is_done: Callable[[], bool], slowly: bool = False) -> Iterator[MotionSegment]:
        """Yield the motions that tilt the tool step by step until `is_done`, or until it has waited fully tilted.

        With `slowly`, a cup tilts by small steps where pieces may slide, so that only a part of them leaves.
        """
        first, largest = float(tilt.angles[0]), float(tilt.angles[-1])
        angle = first
        step, waits = _SPOON_STEP if self.tool.is_spoon else _POUR_STEP, 0
        while not is_done() and waits < _MAX_WAITS:
            self.weigh()
            goal = min(angle + step, largest)
            if slowly and not self.tool.is_spoon:
                goal = min(max(angle + _SLOW_STEP, _SLIDING), largest)
            if goal > angle:
                yield self.context.make_segment({self.hand: straight_tilt(tilt, angle, goal)}, wait_for_arrival=False)
            else:
                waits += 1
                yield self.context.wait_segment(TICKS)
            angle = goal
        self.weigh()

    def travel(self, joints: Array) -> Iterator[MotionSegment]:
        """Yield the motions that bring the tool to other joints (dof,).

        It turns evenly on the way, or goes around obstacles in any orientation.
        """
        context, hand = self.context, self.hand
        held = hand.held_object
        assert held is not None
        load = AttachedObject(self.tool_name, held.T_thing_in_pinch)
        first, last = (hand.pinch_pose(at) @ held.T_thing_in_pinch for at in (hand.joints, joints))
        shares = _WAY_SHARES if self.tool.is_spoon or self.carried() else _EMPTY_WAY_SHARES
        for over in _WAY_RISES:
            poses = _way_poses(first, last, shares, over)
            rows = plan_knots(context, hand, hand.opening, load, poses, hand.joints)
            if len(rows) == len(poses) and all(
                is_free_step(context, hand, hand.opening, load, start, end)
                for start, end in ((hand.joints, rows[0]), (rows[-1], joints))
            ):
                yield from self.follow(np.array([*rows, joints]))
                return
        path = context.plan_free_path(hand, joints, hand.opening, load)
        yield context.make_segment({hand: path}, wait_for_arrival=False)

    def follow(self, rows: Array) -> Iterator[MotionSegment]:
        """Yield the motions through joints (n, dof), evenly between two of them."""
        step = _SPOON_JOINT_STEP if self.tool.is_spoon else _CUP_JOINT_STEP
        for row in rows:
            start = self.hand.joints
            actions = max(1, math.ceil(float(np.abs(row - start).max()) / step))
            path = np.linspace(start, row, TICKS * actions + 1)
            yield self.context.make_segment({self.hand: path}, wait_for_arrival=False)


def _way_poses(T0: Array, T1: Array, shares: Sequence[float], over: float) -> list[Array]:
    """Return a tool's poses (4, 4) at shares of a way on which it turns evenly, `over` m over its higher end."""
    turn = rotation_vector(T0[:3, :3].T @ T1[:3, :3])
    poses = []
    for share in shares:
        T = T0.copy()
        T[:3, 3] += share * (T1[:3, 3] - T0[:3, 3])
        T[2, 3] = max(T0[2, 3], T1[2, 3]) + over
        T[:3, :3] = T0[:3, :3] @ rotation_from_vector(share * turn)
        poses.append(T)
    return poses
