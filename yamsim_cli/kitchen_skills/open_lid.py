"""Open a container's lid with two hands: one steadies the container, the other unscrews the lid or pulls it off."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, FiniteFloat

from ..core.attempt_data import FailureCause
from ..core.config.goals.role_assignment import RoleAssignment
from ..core.config.objects.articulation import Handle, Link
from ..core.config.program_task import ProgramTask
from ..core.expert.skills.common_motions import CLOSING_TICKS, park_hand, release_and_retreat
from ..core.expert.skills.grasp_candidates import is_orientation_plausible
from ..core.expert.skills.hand import WAYPOINT_TOLERANCE, Hand
from ..core.expert.skills.operate import missing_part
from ..core.expert.skills.planning_context import FingerTarget, MotionSegment, PlanningContext, SkillFailedError
from ..core.expert.skills.skill import Skill
from ..core.geometry.se3 import Array, pose, rotation_from_vector, rotation_vector, rotation_z

_PULLED_LID_JOINT = "slide"  # type of the joint of a lid that is pulled off
_FORCE = 50.0  # N, asked of each finger. Source: I2RT's SDK limits grippers to 50 N per finger
_APPROACH = 0.04  # m, length of the straight approach to a handle
_CLEARANCE = 0.008  # m, additional opening of each finger before closing and after release
_MAX_JOINT_STEP = 0.6  # rad, of a joint in one step of a turn; more is another posture
# rad, largest angle between two postures of a turn with the lid, and of a turn back: first for hands that point
# straight down, which turn by their last joint, then for other hands.
_FORWARD_STEPS = (math.radians(55), math.radians(30))
_BACKWARD_STEPS = (math.radians(60), math.radians(45))
_POINTS_DOWN = 0.99  # cosine of the angle from vertical, above which a hand points straight down
_MAX_STEP_OF_PATH = 1.6  # rad, of a joint between two of these postures; more is another posture
_TURN_STEP = math.radians(8)  # rad, between the angles of a turn at which contacts are checked
_START_STEPS = 2  # steps of a turn between grasps that are tried to begin it
_SIMILAR_TURN = math.radians(5)  # rad; a longer turn is preferred if it gains more than this
_SIMILAR_LEVER = 0.002  # m; levers are compared in steps of this
_APPROACH_CHECKS = 4  # postures of an approach at which contacts are checked
_MIN_TURN = math.radians(25)  # rad, shortest turn of a hand that is tried
_MIN_GAIN = 0.1  # share of the hand's turn by which the lid has to turn; else it slips between the fingers
_MAX_TURNS = 14  # grasps of a screw lid
_FORCE_STEP, _MAX_PULL = 5.0, 30.0  # N, of pulls at a snap lid, each of which is stronger; pads slip above 30 N
_HOLD_SECONDS = 0.6  # s, for which a lid is held up at the end; goals have hold times of up to 0.5 s
_DIFFERENCE = 1e-5  # rad, of the joints between two poses whose difference gives a Jacobian


@dataclass(frozen=True)
class _Reach:
    """A hand's joints (dof,) before and at a grasp, rad, its pinch pose (4, 4), and its opening on the way, m."""

    hand: Hand
    handle: Handle
    T_pinch: Array
    before: Array
    at: Array

    @property
    def opening(self) -> float:
        return min(self.handle.opening + _CLEARANCE, self.hand.max_opening)


class OpenLid(Skill):
    """Open the lid of a container, the part `joint`, until its joint is open by the share `to`.

    One hand grasps a handle of the container and steadies it. The other hand grasps a handle of the lid from above. It
    turns a screw lid, several times if needed, and pulls any other lid up. Both hands stay closed after a pull, because
    a lid that is let go falls back. The skill is then the last one of a program.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    HANDS: ClassVar[int] = 2
    REQUIRES_HELD_OBJECT: ClassVar[bool | None] = False
    thing: str
    joint: str = "lid"
    to: Annotated[FiniteFloat, Field(ge=0, le=1)] = 0.8

    def task_fault(self, task: ProgramTask) -> tuple[str, str] | None:
        """Check that each object has a lid with a handle, and a handle at which a hand can steady it."""
        for item in task.possible_objects(self.thing):
            if not item.handles:
                return "thing", f"the {item.name} has no handle at which a hand could steady it; add one to `handles`"
        return missing_part(task, self.thing, self.joint)

    def reason_to_be_last(self, task: ProgramTask) -> str | None:
        """Return that no hand is free after a pull, if the task has a lid that is pulled off."""
        for item in task.possible_objects(self.thing):
            if any(link.name == self.joint and link.joint.type == _PULLED_LID_JOINT for link in item.links):
                return (
                    f"no hand is free after `open_lid`: the hands hold the {item.name} and its lid, which would fall "
                    "back if let go; make `open_lid` the last step"
                )
        return None

    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """Do nothing if the lid is open already; see `Skill.run`."""
        thing = roles.object_of(self.thing)
        if self._is_open(context, thing):
            return
        link = next(link for link in context.object_configs[thing].links if link.name == self.joint)
        if link.joint.type == "screw":
            steady, grip, turn = self._find_turn(context, thing, link)
        else:
            steady, grip = self._find_pull(context, thing, link)
        yield from _approach(context, steady)
        yield _close_fingers(context, steady)
        yield from _approach(context, grip)
        if link.joint.type == "screw":
            yield from self._unscrew(context, thing, link, grip, steady, turn)
        else:
            yield from self._pull(context, thing, grip, steady)
        opened = context.world.joint_opening(thing, self.joint)
        if opened >= self.to and link.joint.type == _PULLED_LID_JOINT:
            # A lid that is let go would fall back onto its container.
            yield context.wait_segment(round(_HOLD_SECONDS / context.tick))
            return
        for reach in (grip, steady):
            yield from release_and_retreat(context, reach.hand, _CLEARANCE)
            yield from park_hand(context, reach.hand)
        if opened < self.to:
            raise SkillFailedError(
                FailureCause.SLIPPED, f"the lid of the {thing} slips between the fingers; it is {opened:.0%} open"
            )

    def _is_open(self, context: PlanningContext, thing: str) -> bool:
        return context.world.joint_opening(thing, self.joint) >= self.to

    def _find_pull(self, context: PlanningContext, thing: str, link: Link) -> tuple[_Reach, _Reach]:
        """Return grasps of the container and of its lid that leave both hands room.

        A lid that is pulled near the hand that steadies tips the container least. Among such grasps, the first handles
        of the container are preferred.
        """
        handles = context.object_configs[thing].handles
        pairs: list[tuple[int, int, _Reach, _Reach]] = []
        reached, fault = self._reached_handles(context, thing, link)
        for steady, grip in itertools.chain.from_iterable(itertools.product(*reaches) for reaches in reached):
            lever = float(np.linalg.norm((grip.T_pinch - steady.T_pinch)[:2, 3]))
            pairs.append((round(lever / _SIMILAR_LEVER), handles.index(steady.handle), steady, grip))
        for _, _, steady, grip in sorted(pairs, key=lambda pair: pair[:2]):
            if _can_approach(context, steady, thing, grip):
                return steady, grip
        raise SkillFailedError(FailureCause.UNREACHABLE, fault)

    def _find_turn(self, context: PlanningContext, thing: str, link: Link) -> tuple[_Reach, _Reach, float]:
        """Return grasps of the container and of its lid that leave both hands room, and the angle of a turn, rad."""
        best: tuple[float, _Reach, _Reach] | None = None
        reached, fault = self._reached_handles(context, thing, link)
        for steadies, grips in reached:
            for steady, postures in itertools.product(steadies, _possible_turns(grips)):
                found = _longest_turn(context, steady, thing, postures)
                if found is not None and (best is None or found[0] > best[0] + _SIMILAR_TURN):
                    best = (found[0], steady, found[1])
        if best is None:
            raise SkillFailedError(FailureCause.UNREACHABLE, fault)
        return best[1], best[2], best[0]

    def _reached_handles(
        self, context: PlanningContext, thing: str, link: Link
    ) -> tuple[list[tuple[list[_Reach], list[_Reach]]], str]:
        """Return the grasps of the container by one hand and of its lid by the other, for each two hands.

        The text says why the lid cannot be opened if no two of these grasps leave both hands room.
        """
        T_lid, T_base = context.world.part_pose(thing, self.joint), context.world.pose(thing)
        found: list[tuple[list[_Reach], list[_Reach]]] = []
        fault = "no two arms reach it and its lid without contact"
        for opener, steadier in itertools.permutations(context.free_hands("any"), 2):
            grips = list(_reaches(context, opener, thing, link.handles, T_lid))
            if grips:
                handles = context.object_configs[thing].handles
                found.append((list(_reaches(context, steadier, thing, handles, T_base)), grips))
            else:
                fault = f"the {opener.side} arm does not reach its lid"
        return found, f"no way to open the {thing}: {fault}"

    def _unscrew(
        self, context: PlanningContext, thing: str, link: Link, grip: _Reach, steady: _Reach, turn: float
    ) -> Iterator[MotionSegment]:
        """Yield the turns of a hand up to `turn`, rad. In between, the hand turns back with open fingers.

        The commands of both hands include the deflection by the lid's torque.
        """
        hand, whole, lead = grip.hand, math.radians(link.joint.range[1]), (link.joint.pitch or 0.0) / (2 * math.pi)
        rise, torque = 0.0, np.array([0.0, 0.0, link.joint.friction])  # of the lid, m and N m
        relaxed = steady.hand.joints.copy()
        firm = relaxed + _deflection(steady.hand, relaxed, np.zeros(3), -torque)
        for _ in range(_MAX_TURNS):
            before = context.world.joint_opening(thing, self.joint) * whole
            yield _close_fingers(context, grip)
            # The lid lags behind the hand by a little.
            angle = min(turn, ((self.to + 0.05) * whole - before) * 1.05)
            higher = rise + lead * angle
            path = _turn_path(context, grip, (0.0, angle), (rise, higher), _FORWARD_STEPS, torque)
            braced = np.linspace(relaxed, firm, CLOSING_TICKS + 1)
            yield context.make_segment({hand: path, steady.hand: braced})
            gained = context.world.joint_opening(thing, self.joint) * whole - before
            if self._is_open(context, thing) or gained < _MIN_GAIN * angle:
                return
            yield context.make_segment(
                {hand: context.hold_still_motion(hand, CLOSING_TICKS), steady.hand: braced[::-1]},
                {hand: FingerTarget(grip.opening)},
                wait_for_arrival=False,
            )
            rise += lead * gained
            path = _turn_path(context, grip, (angle, 0.0), (higher, rise), _BACKWARD_STEPS, np.zeros(3))
            yield context.make_segment({hand: path}, wait_for_arrival=False)

    def _pull(self, context: PlanningContext, thing: str, grip: _Reach, steady: _Reach) -> Iterator[MotionSegment]:
        """Yield motions in which one hand pulls a lid up, more each time, and the other holds the container down."""
        yield _close_fingers(context, grip)
        lever = grip.T_pinch[:3, 3] - steady.T_pinch[:3, 3]
        starts = {reach.hand: reach.hand.joints.copy() for reach in (grip, steady)}
        for force in np.arange(_FORCE_STEP, _MAX_PULL + _FORCE_STEP / 2, _FORCE_STEP):
            up = np.array([0.0, 0.0, force])
            # The hand that steadies also keeps the container from tipping towards the hand that pulls.
            loads = {grip.hand: (up, np.zeros(3)), steady.hand: (-up, -np.cross(lever, up))}
            paths = {}
            for hand, (push, twist) in loads.items():
                there = starts[hand] + _deflection(hand, starts[hand], push, twist)
                paths[hand] = np.linspace(hand.joints, there, CLOSING_TICKS + 1)
            yield context.make_segment(paths)
            if self._is_open(context, thing):
                return


def _deflection(hand: Hand, joints: Array, force: Array, torque: Array) -> Array:
    """Return the difference (dof,) of commanded joints from `joints`, rad.

    It is such that the hand exerts a force and a torque while its joints stay at `joints`.

    Args:
        force, torque: (3,) at the hand's pinch frame, in `world`, N and N m.
    """
    T, efforts = hand.pinch_pose(joints), np.empty(len(joints))
    for k in range(len(joints)):
        moved = joints.copy()
        moved[k] += _DIFFERENCE
        T_moved = hand.pinch_pose(moved)
        turn = rotation_vector(T_moved[:3, :3] @ T[:3, :3].T)
        efforts[k] = ((T_moved[:3, 3] - T[:3, 3]) @ force + turn @ torque) / _DIFFERENCE
    offset: Array = efforts / hand.arm.position_gain
    return offset


def _reaches(
    context: PlanningContext, hand: Hand, thing: str, handles: Sequence[Handle], T_part: Array
) -> Iterator[_Reach]:
    """Yield the ways in which a hand reaches handles without contact, with the fingers either way around."""
    for handle, turn in itertools.product(handles, (0.0, math.pi)):
        T_pinch = T_part @ handle.T_pinch_in_part @ pose(rotation=rotation_from_vector([0.0, 0.0, turn]))
        if not is_orientation_plausible(T_pinch, hand.arm.T_base_in_world):
            continue
        opening = min(handle.opening + _CLEARANCE, hand.max_opening)
        at = hand.solve_ik(T_pinch, (hand.joints, hand.ready_joints))
        if at is None or context.find_contact(hand, at, opening, grasped=thing):
            continue
        before = _joints_before(hand, T_pinch, at)
        if before is not None and context.find_contact(hand, before, opening) is None:
            yield _Reach(hand, handle, T_pinch, before, at)


def _joints_before(hand: Hand, T_pinch: Array, at: Array) -> Array | None:
    return hand.solve_ik(T_pinch @ pose((0.0, 0.0, -_APPROACH)), (at,), WAYPOINT_TOLERANCE)


def _is_blocked(
    context: PlanningContext, steady: _Reach, thing: str, hand: Hand, joints: Array, opening: float
) -> bool:
    """Return whether a hand with `joints` has a contact while another one steadies the object."""
    qpos = context.qpos_with_hand(steady.hand, steady.at, steady.handle.opening, None)
    return context.collision_checker.find_contact(qpos, hand.number, joints, opening, grasped=thing) is not None


def _can_approach(context: PlanningContext, steady: _Reach, thing: str, grip: _Reach) -> bool:
    """Return whether a hand can approach a lid while another one steadies the container."""
    way = np.linspace(grip.before, grip.at, _APPROACH_CHECKS)
    return not any(_is_blocked(context, steady, thing, grip.hand, joints, grip.opening) for joints in way)


def _possible_turns(grips: Sequence[_Reach]) -> Iterator[list[_Reach]]:
    """Yield turns of a hand around a lid, each as its grasps in steps of `_TURN_STEP`, as far as the arm reaches.

    Grasps that a turn includes do not begin a turn.
    """
    included: list[Array] = []
    for grip in grips:
        if any(np.abs(grip.T_pinch[:3, :3] - T[:3, :3]).max() < _TURN_STEP for T in included):
            continue
        postures = [*reversed(list(_turn_one_way(grip, -_TURN_STEP))), grip, *_turn_one_way(grip, _TURN_STEP)]
        included += [posture.T_pinch for posture in postures]
        yield postures


def _turn_one_way(grip: _Reach, step: float) -> Iterator[_Reach]:
    hand, joints = grip.hand, grip.at
    for k in range(1, int(2 * math.pi / abs(step))):
        T_pinch = grip.T_pinch.copy()
        T_pinch[:3, :3] = rotation_z(k * step) @ grip.T_pinch[:3, :3]
        found = hand.solve_ik(T_pinch, (joints,))
        if found is None or np.abs(found - joints).max() > _MAX_JOINT_STEP:
            return
        joints = found
        yield _Reach(hand, grip.handle, T_pinch, joints, joints)


def _longest_turn(
    context: PlanningContext, steady: _Reach, thing: str, postures: Sequence[_Reach]
) -> tuple[float, _Reach] | None:
    """Return the longest part of a turn that is free of contacts, rad, and the grasp where it begins."""
    free = [not _is_blocked(context, steady, thing, one.hand, one.at, one.opening) for one in postures]
    runs = [(key, list(group)) for key, group in itertools.groupby(range(len(free)), free.__getitem__)]
    for _, run in sorted((item for item in runs if item[0]), key=lambda item: -len(item[1])):
        # One step at each end is the distance from the next contact.
        for k in range(1, len(run) - 2, _START_STEPS):
            span = (len(run) - 2 - k) * _TURN_STEP
            if span < _MIN_TURN:
                break
            start = postures[run[k]]
            before = _joints_before(start.hand, start.T_pinch, start.at)
            if before is None:
                continue
            start = replace(start, before=before)
            if _can_approach(context, steady, thing, start):
                return span, start
    return None


def _turn_path(
    context: PlanningContext,
    grip: _Reach,
    angles: tuple[float, float],
    rises: tuple[float, float],
    steps: tuple[float, float],
    torque: Array,
) -> Array:
    """Return a motion (n + 1, dof) that turns a hand about the vertical through its pinch.

    Joints move evenly between the postures of a few angles, each in the ticks of one action. A finer path would bend
    more often, and every bend costs an action.

    Args:
        angles: first and last angle from `grip`, rad.
        rises: first and last height over `grip`, m.
        steps: largest angle between two postures, of hands that point down and of others, rad.
        torque: (3,) that the hand exerts, in `world`, N m.
    """
    hand, points_down = grip.hand, grip.T_pinch[2, 2] < -_POINTS_DOWN
    count = max(math.ceil(abs(angles[1] - angles[0]) / steps[0 if points_down else 1]), 1)
    rows, last = [hand.joints[None]], hand.joints
    for share in np.linspace(0.0, 1.0, count + 1)[1:]:
        T_pinch = grip.T_pinch.copy()
        T_pinch[:3, :3] = rotation_z(angles[0] + share * (angles[1] - angles[0])) @ T_pinch[:3, :3]
        T_pinch[2, 3] += rises[0] + share * (rises[1] - rises[0])
        there = hand.solve_ik(T_pinch, (last,))
        if there is None or np.abs(there - last).max() > _MAX_STEP_OF_PATH:
            raise SkillFailedError(FailureCause.UNREACHABLE, f"a turn of the lid leaves the {hand.side} arm's reach")
        pressed = there + _deflection(hand, there, np.zeros(3), torque)
        rows.append(np.linspace(rows[-1][-1], pressed, CLOSING_TICKS + 1)[1:])
        last = there
    return np.concatenate(rows)


def _approach(context: PlanningContext, reach: _Reach) -> Iterator[MotionSegment]:
    hand = reach.hand
    yield context.make_segment(
        {hand: context.plan_free_path(hand, reach.before, reach.opening)}, {hand: FingerTarget(reach.opening)}
    )
    yield context.make_segment({hand: context.plan_line(hand, reach.T_pinch)})


def _close_fingers(context: PlanningContext, reach: _Reach) -> MotionSegment:
    closing = FingerTarget(reach.handle.opening, _FORCE)
    return context.make_segment(
        {reach.hand: context.hold_still_motion(reach.hand, CLOSING_TICKS)}, {reach.hand: closing}
    )
