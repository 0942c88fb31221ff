"""The moment at which the expert takes over a failed trial of a policy, and the start of its program."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from ..core.attempt_data import ActionSequence, StepState
from ..core.config.goals.role_assignment import RoleAssignment
from ..core.config.program_task import ProgramTask
from ..core.episode.episode import Episode
from ..core.errors import UsageError
from ..core.expert.skills.common_motions import release_and_retreat, rest_segment
from ..core.expert.skills.hand import Hand, HeldObject
from ..core.expert.skills.pick import Pick
from ..core.expert.skills.planning_context import MotionSegment, PlanningContext, SkillFailedError
from ..core.expert.skills.program import build_program, skill_object
from ..core.expert.skills.put_aside import PutAside
from ..core.geometry.se3 import invert_pose

# Largest change of a value of qpos from one recorded frame to the next at rest: 1 mm, 1 mrad of a joint, or 2 mrad of
# an object's rotation. Frames are 64 ms apart by default, so 1 mm is 16 mm/s: objects that lie move less.
REST_MOTION = 1e-3


def require_one_rigid_object(task: ProgramTask) -> None:
    """Raise UsageError unless the task's expert handles a single object without cloth.

    The expert begins its program again at the takeover. A program that handles several objects would first move those
    again that lie at their goal, and a fold needs the cloth as it lay at the start.
    """
    roles = task.typical_roles
    program = build_program(task, roles)
    handled = list(dict.fromkeys(skill_object(skill, roles) for skill in program))
    if any(skill.HANDLES_CLOTH for skill in program):
        cloth = next(skill_object(skill, roles) for skill in program if skill.HANDLES_CLOTH)
        why = f"handles cloth ({cloth}), which it folds only from the start of an episode"
    elif len(handled) > 1:
        why = f"handles {len(handled)} objects ({', '.join(handled)}), and would move them all again"
    else:
        return
    raise UsageError(
        f"--task {task.name}: its expert {why}, so it cannot take over from a policy; give a task with one rigid "
        "object, such as pickplace"
    )


def takeover_frame(states: Sequence[StepState], rewind_s: float, frame_s: float) -> int:
    """Return the recorded frame at whose start the expert takes over.

    The trial is rewound by `rewind_s` from its end, or, if nothing moved at its end, from the last motion before.

    Args:
        states: one for each recorded frame of the policy's trial.
        rewind_s: time to rewind, s. A trial that is shorter is taken over at its start.
        frame_s: time between frames, s.
    """
    positions = np.array([state.qpos for state in states])
    moving = np.flatnonzero(np.abs(np.diff(positions, axis=0)).max(axis=1, initial=0.0) > REST_MOTION)
    last = int(moving[-1]) + 1 if len(moving) else 0
    # Rounding errors of the quotient must not add a frame.
    return max(0, last - math.ceil(rewind_s / frame_s - 1e-9))


@dataclass(frozen=True)
class ExpertTakeover:
    """Repeats a policy's actions in an episode, and returns the expert's first motions, see `execution.Takeover`.

    A hand keeps the object that the program picks first. A hand that holds any other object alone puts it aside. Two
    hands that hold one object open.

    Attributes:
        actions: of the policy, up to the takeover.
    """

    actions: ActionSequence
    task: ProgramTask
    roles: RoleAssignment

    def __call__(self, episode: Episode, context: PlanningContext) -> Iterator[MotionSegment]:
        """Run the policy's actions now; plan each motion when the iterator gets to it."""
        episode.run_commands(self.actions)
        for hand in context.hands:
            _take_hand(context, hand)
        return self._begin(episode, context)

    def _begin(self, episode: Episode, context: PlanningContext) -> Iterator[MotionSegment]:
        holders = _holding_hands(episode, context)
        for thing, hands in holders.items():
            for hand in hands:
                _take_grasp(context, hand, thing)
        # The arms stop, and what the policy pushed or dropped comes to rest.
        yield rest_segment(context)
        first = build_program(self.task, self.roles)[0]
        wanted = skill_object(first, self.roles) if isinstance(first, Pick) else None
        for thing, hands in holders.items():
            if thing == wanted and len(hands) == 1:
                continue
            if len(hands) == 1:
                with suppress(SkillFailedError):
                    yield from PutAside(thing=thing).run(context, self.roles, ())
            for hand in hands:
                if hand.held_object is not None:
                    yield from release_and_retreat(context, hand, context.release_clearance(thing))


def _take_hand(context: PlanningContext, hand: Hand) -> None:
    """Start the plan from an arm's present joints and opening."""
    arm = hand.arm
    hand.joints = np.clip(context.qpos[arm.joint_qpos], arm.joint_range[:, 0], arm.joint_range[:, 1])
    if arm.fingers is not None:
        hand.opening = float(np.clip(context.finger_opening(hand), 0.0, hand.max_opening))


def _holding_hands(episode: Episode, context: PlanningContext) -> dict[str, list[Hand]]:
    """Return object -> acting hands that hold it. A hand that grasps by a weld holds only while the weld is active."""
    welded = episode.welds_active
    found = {}
    for thing, sides in context.world.holding_sides_by_object().items():
        hands = [hand for hand in context.acting_hands if hand.side in sides]
        if holding := [hand for hand in hands if welded[hand.number] or not hand.grasps_by_weld]:
            found[thing] = holding
    return found


def _take_grasp(context: PlanningContext, hand: Hand, thing: str) -> None:
    """Keep a hand's grasp as the policy commands it: its weld, or the force of its fingers."""
    hand.held_object = HeldObject(thing, invert_pose(context.T_pinch(hand)) @ context.world.pose(thing))
    hand.weld_commanded = hand.grasps_by_weld
    fingers = hand.arm.fingers
    if fingers is not None and not hand.grasps_by_weld:
        commanded = float(context.world.data.ctrl[fingers.ctrl])
        # The inverse of `gripper_drive_commands`: two fingers share the drive's force, gain * (opening - command).
        hand.grip_force = max(0.0, (hand.opening - commanded) * fingers.gain / 2)
