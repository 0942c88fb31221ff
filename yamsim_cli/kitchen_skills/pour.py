"""Pour the loose pieces in an object into a vessel."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from ..core.attempt_data import FailureCause
from ..core.config.goals.role_assignment import RoleAssignment
from ..core.config.program_task import ProgramTask
from ..core.expert.planning.collision_checker import AttachedObject
from ..core.expert.skills.hand import Hand
from ..core.expert.skills.pick import Pick, ReachableGrasp, summarize_reasons
from ..core.expert.skills.planning_context import MotionSegment, PlanningContext, SkillFailedError
from ..core.expert.skills.skill import Skill, find_holding_hand
from ..core.geometry.se3 import Array, invert_pose
from .held_pieces import LoosePieces, fault_of_pieces, fault_of_shape
from .tilting import (
    TICKS,
    HeldSource,
    PouringTilt,
    carry_upright,
    grasps_from_side,
    longest_tilt,
    reachable_grasps,
    tilt_path,
)

_LIFT = 0.05  # m
_RISE, _MAX_RISES = 0.04, 6  # m and count, of the steps in which a hand rises from a source that it touches

# rad, score of a tilt after which no other grasp is tried. With 145 degrees, a grasp that tilts by 130 was taken, and
# threw pieces beside a bowl. Over a narrow vessel, shakes are short, so that no tilt has this score.
_ENOUGH_TILT = math.radians(150)
_FAST_STEP, _SLOW_STEP = math.radians(12), math.radians(4)  # rad, of a step before and after the first piece left
# Share of the pieces that may leave in a step over a narrow vessel. If more leave, the source tilts back.
_MAX_FLOW = 0.05
_BACK_STEP = math.radians(1)  # rad, by which it tilts back in a step
_TRIES_PER_SWING = 3  # tries that move no piece, the last of which is a swing; the others are shakes
_SWING_STEP = math.radians(30)  # rad, of each of the two steps back of a swing
_MAX_TRIES = 20  # shakes and swings in a row that move no piece out, after which the expert gives up


class Pour(Skill):
    """Pour the loose pieces in `thing` into another object until all of them have left.

    A hand grasps the source from the side, carries it over the vessel, and tilts it by steps, slowly once pieces leave.
    Over a narrow vessel, it tilts back a little while many pieces leave. At its largest tilt, it shakes the source
    along its axis. Then it tilts the source back, and keeps it in the hand.

    The skill counts the pieces in the source, so a piece that still falls counts as poured. It cannot pour a part of
    the content: pieces slide out together, up to three quarters of them in one action.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "into")
    REQUIRES_HELD_OBJECT: ClassVar[bool | None] = False
    TYPICAL_SECONDS: ClassVar[float] = 12.0
    LEAVES_OBJECT_HELD: ClassVar[bool | None] = True
    thing: str
    into: str

    def task_fault(self, task: ProgramTask) -> tuple[str, str] | None:
        """Check that the source has loose pieces, and that both objects have suitable shapes."""
        return (
            fault_of_pieces(task, "thing", self.thing)
            or fault_of_shape(task, "thing", self.thing, ("vessel", "container"))
            or fault_of_shape(task, "into", self.into, ("vessel",))
        )

    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """Do nothing if the source is empty already; see `Skill.run`."""
        thing, vessel = roles.object_of(self.thing), roles.object_of(self.into)
        pieces = LoosePieces(context, thing)
        if pieces.share_outside == 1.0:
            return
        configs = context.object_configs
        try:
            yield from self._pour(context, thing, vessel, pieces)
        finally:
            # `LoosePieces.weigh` has changed them.
            context.object_configs = configs

    def _pour(self, context: PlanningContext, thing: str, vessel: str, pieces: LoosePieces) -> Iterator[MotionSegment]:
        hand = find_holding_hand(context, thing)
        if hand is None:
            yield from _raise_touching_hands(context)
            pieces.weigh()
            hand, grasp = self._find_grasp(context, thing, vessel, pieces.length)
            yield from Pick(thing=self.thing, lift=_LIFT).grasp_and_lift(context, hand, thing, grasp)
        load = AttachedObject(thing, context.measure_held_object(hand).T_thing_in_pinch)
        tilt = longest_tilt(context, HeldSource(hand, load, hand.joints, hand.opening, pieces.length), vessel)
        if tilt is None:
            raise SkillFailedError(FailureCause.UNREACHABLE, f"no way to tilt the {thing} over the {vessel}")
        yield from carry_upright(context, hand, tilt)
        yield from self._tilt_until_poured(context, hand, tilt, pieces)

    def _find_grasp(
        self, context: PlanningContext, thing: str, vessel: str, piece_length: float
    ) -> tuple[Hand, ReachableGrasp]:
        """Return the hand and the grasp with which the source tilts furthest."""
        best: tuple[float, Hand, ReachableGrasp] | None = None
        picker, reasons = Pick(thing=self.thing, lift=_LIFT), Counter[str]()
        candidates = list(grasps_from_side(context.object_configs[thing]))
        for hand, found in reachable_grasps(context, picker, thing, candidates, reasons):
            load = AttachedObject(thing, invert_pose(found.candidate.T_pinch_in_thing))
            source = HeldSource(hand, load, found.grasp_joints, found.candidate.opening, piece_length)
            tilt = longest_tilt(context, source, vessel)
            if tilt is None:
                reasons[f"the {hand.side} arm cannot tilt it over the {vessel} with this grasp"] += 1
            elif best is None or tilt.score > best[0]:
                best = (tilt.score, hand, found)
                if best[0] >= _ENOUGH_TILT:
                    break
        if best is None:
            why = summarize_reasons(reasons) or "no hand is free"
            raise SkillFailedError(FailureCause.UNREACHABLE, f"no grasp to pour from the {thing}: {why}")
        return best[1], best[2]

    def _tilt_until_poured(
        self, context: PlanningContext, hand: Hand, tilt: PouringTilt, pieces: LoosePieces
    ) -> Iterator[MotionSegment]:
        """Yield the motions that tilt the source until it is empty, shake it at the largest angle, and tilt it back.

        Raise SkillFailedError if pieces stay in it, or if it falls out of the hand.
        """
        angle, poured, most, tries = 0.0, pieces.share_outside, 0.0, 0
        largest = float(tilt.angles[-1])
        while poured < 1.0 and tries < _MAX_TRIES:
            pieces.weigh()
            goal = min(angle + (_FAST_STEP if poured == 0 else _SLOW_STEP), largest)
            if tilt.over_narrow_vessel and poured > most + _MAX_FLOW:
                # A little back, so that the flow ends.
                goal = max(angle - _BACK_STEP, 0.0)
            most = max(most, poured)
            if angle < largest or goal < largest:
                yield context.make_segment({hand: tilt_path(tilt, angle, goal)}, wait_for_arrival=False)
            else:
                is_swing = tries % _TRIES_PER_SWING == _TRIES_PER_SWING - 1 and not tilt.over_narrow_vessel
                for path in _swing(tilt) if is_swing else _shake(tilt):
                    yield context.make_segment({hand: path}, wait_for_arrival=False)
            angle, poured = goal, pieces.share_outside
            # A piece that goes in and out of the mouth counts once.
            tries = tries + 1 if poured <= most and angle == largest else 0
        context.measure_held_object(hand)
        while angle > 0:
            pieces.weigh()
            goal = max(0.0, angle - 2 * _FAST_STEP)
            yield context.make_segment({hand: tilt_path(tilt, angle, goal)}, wait_for_arrival=False)
            angle = goal
        if tries == _MAX_TRIES:
            raise SkillFailedError(
                FailureCause.GOAL,
                f"only {most:.0%} of the pieces left the source: {_MAX_TRIES} shakes in a row moved none",
            )


def _raise_touching_hands(context: PlanningContext) -> Iterator[MotionSegment]:
    """Yield the motions that raise hands which touch something at the start, such as a tall source."""
    for hand in context.free_hands("any"):
        T = hand.pinch_pose(hand.joints)
        for _ in range(_MAX_RISES):
            if context.find_contact(hand, hand.joints, hand.opening) is None:
                break
            T[2, 3] += _RISE
            yield context.make_segment({hand: context.plan_line(hand, T)})


def _shake(tilt: PouringTilt) -> Iterator[Array]:
    """Yield the motions (n + 1, dof) of a shake along the source's axis, at the largest tilt."""
    yield np.linspace(tilt.joints[-1], tilt.back, TICKS + 1)
    yield np.linspace(tilt.back, tilt.joints[-1], TICKS + 1)


def _swing(tilt: PouringTilt) -> Iterator[Array]:
    """Yield the motions (n + 1, dof) that tilt a source back and again, which loosens pieces that wedge each other."""
    largest = float(tilt.angles[-1])
    for start, end in ((0.0, 1.0), (1.0, 2.0), (2.0, 1.0), (1.0, 0.0)):
        yield tilt_path(tilt, largest - start * _SWING_STEP, largest - end * _SWING_STEP)
