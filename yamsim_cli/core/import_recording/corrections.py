"""What a user says of a recording that does not say it itself, or says it wrongly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..config.real import GripperUnit
from ..errors import DatasetError, UsageError
from ..recordings.faults import Fault, Problem
from ..recordings.recording import Recording

# Faults that make other data of a recording; all others are told and kept in its record.
_WRONG = {
    Fault.DEGREES: "--degrees",
    Fault.SWAPPED_ARMS: "--swap-arms",
    Fault.GRIPPER_SHARE: "--gripper share",
    Fault.GRIPPER_UPSIDE_DOWN: "--gripper closed_share",
}


@dataclass(frozen=True)
class Corrections:
    """What a user says.

    Attributes:
        degrees: that joints are in degrees.
        swap_arms: that what was measured of the left arm is the right one's.
        gripper: in which unit openings are; None for the format's own.
    """

    degrees: bool = False
    swap_arms: bool = False
    gripper: GripperUnit | None = None


def corrected(recording: Recording, said: Corrections) -> Recording:
    """A recording as the user says that it is.

    Raises:
        UsageError: arms are to be swapped of a lone one.
    """
    motion = recording.motion
    if said.swap_arms:
        if len(motion.arms) != 2:
            raise UsageError("--swap-arms: the rig has one arm; give a --rig with two, or leave it out")
        left, right = motion.arms
        motion = replace(
            motion,
            arms=(
                replace(left, joints=right.joints, openings=right.openings, velocities=right.velocities),
                replace(right, joints=left.joints, openings=left.openings, velocities=left.velocities),
            ),
        )
    if said.degrees:
        arms = tuple(
            replace(
                arm,
                joints=np.deg2rad(arm.joints),
                commands=None if arm.commands is None else np.deg2rad(arm.commands),
                velocities=None if arm.velocities is None else np.deg2rad(arm.velocities),
            )
            for arm in motion.arms
        )
        motion = replace(motion, arms=arms)
    return replace(recording, motion=motion, gripper=said.gripper or recording.gripper)


def require_right(name: str, problems: Sequence[Problem]) -> None:
    """Make sure that nothing is wrong with a recording that would make other data of it.

    Raises:
        DatasetError: something is; the message has the flag that says otherwise.
    """
    for problem in problems:
        if (flag := _WRONG.get(problem.fault)) is not None:
            raise DatasetError(f"{name}: {problem.text} If so, say {flag}")
