"""What a user says of a recording that does not say it itself, or says it wrongly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ..config.real import GripperUnit
from ..config.rig import RigConfig
from ..errors import DatasetError, UsageError
from ..motion import Motion
from ..recordings.faults import Fault, Problem
from ..recordings.recording import Recording

# Which openings are told from the other end.
Mirrored = Literal["measured", "commanded", "both"]

# Faults that make other data of a recording; all others are told and kept in its record.
_WRONG = {
    Fault.DEGREES: "--degrees",
    Fault.SWAPPED_ARMS: "--swap-arms",
    Fault.GRIPPER_SHARE: "--gripper share",
    Fault.GRIPPER_UPSIDE_DOWN: "--mirror-gripper measured, or commanded",
}


@dataclass(frozen=True)
class Corrections:
    """What a user says.

    Attributes:
        degrees: that joints are in degrees.
        swap_arms: that what was measured of the left arm is the right one's.
        gripper: in which unit openings are; None for the format's own.
        mirrored: which openings are told from the other end: 0 open, and wide closed.
    """

    degrees: bool = False
    swap_arms: bool = False
    gripper: GripperUnit | None = None
    mirrored: Mirrored | None = None


def corrected(recording: Recording, said: Corrections, rig: RigConfig) -> Recording:
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
    unit = said.gripper or recording.gripper
    if said.mirrored is not None:
        motion = _mirrored(motion, said.mirrored, unit, rig)
    return replace(recording, motion=motion, gripper=unit)


def _mirrored(motion: Motion, which: Mirrored, unit: GripperUnit, rig: RigConfig) -> Motion:
    """A motion whose openings go the other way."""
    arms = []
    for arm, k in zip(motion.arms, rig.recorded, strict=True):
        fingers = rig.arms[k].robot.fingers
        full = fingers.full_opening if fingers and unit == "metres" else 1.0
        measured = arm.openings if which == "commanded" or arm.openings is None else full - arm.openings
        told = arm.commanded_openings
        told = told if which == "measured" or told is None else full - told
        arms.append(replace(arm, openings=measured, commanded_openings=told))
    return replace(motion, arms=tuple(arms))


def require_right(name: str, problems: Sequence[Problem]) -> None:
    """Make sure that nothing is wrong with a recording that would make other data of it.

    Raises:
        DatasetError: something is; the message has the flag that says otherwise.
    """
    for problem in problems:
        if (flag := _WRONG.get(problem.fault)) is not None:
            raise DatasetError(f"{name}: {problem.text} If so, say {flag}")
