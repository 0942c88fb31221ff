"""What is wrong with a recorded motion: what was cut out of it, and units and arms that were mistaken."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from ..config.rig import RigConfig
from ..documents.units import Within
from ..errors import DatasetError
from ..geometry.se3 import Array
from ..motion import ArmMotion, Motion
from ..robots.robot import Robot

# A pause between samples is a gap if it is so many times the usual one, and longer than this, s.
_GAP_TIMES, _GAP_S = 5.0, 0.1
# A joint beyond its stops by more than this, rad, cannot be: arms are calibrated to a degree or two.
_BEYOND_STOPS = 0.1
# No joint turns by as much, rad; degrees do.
_NO_RADIANS = 2 * math.pi
_PERIOD = Within("s", 1e-5, 0.5)  # Usual time between samples: 100 kHz to 2 Hz. At 1 kHz and in ms it is 1.
# What a command does to its joint, and to no other one: a motion is told from stillness, rad.
_MOTION = 0.05
# Where each arm's commands fit the other arm's joints so many times better, arms are swapped.
_SWAPPED = 3.0
# An opening wider than the fingers open by so much is no metres.
_WIDER = 1.1
# A joint whose measurement does not change for so long while its command does, s and rad.
_FROZEN_S, _FROZEN_COMMAND = 1.0, 0.1
# Openings that go down as their commands go up.
_UPSIDE_DOWN = -0.5
# Fingers that open by less say nothing, as a share of how far they open.
_SOME_OPENING = 0.2
# Fingers stall that stand still for so long, s, by so much of their way from where they are told to be.
_STALL_S, _STALL = 0.5, 0.2
# They stand still while they are slower, in their way a second: noise of an encoder is half of it.
_SLOW = 0.2


class Fault(StrEnum):
    """A kind of fault."""

    GAP = "gap"
    DEGREES = "degrees"
    TIME_UNIT = "time_unit"
    BEYOND_STOPS = "beyond_stops"
    TOO_FAST = "too_fast"
    SWAPPED_ARMS = "swapped_arms"
    FROZEN = "frozen"
    GRIPPER_SHARE = "gripper_share"
    GRIPPER_UPSIDE_DOWN = "gripper_upside_down"
    GRIPPER_STALLS_OPENING = "gripper_stalls_opening"


# Faults that make every number of a comparison wrong.
_WRONG_UNITS = (Fault.DEGREES, Fault.TIME_UNIT)


@dataclass(frozen=True)
class Problem:
    """Something wrong with a motion.

    Attributes:
        fault: what kind it is.
        arm: `left`, `right`, or empty of a lone arm or of the whole motion.
        joint: whose; empty of the whole arm.
        time: when it begins, s; None of all of it.
        text: for a person, with the value and what to do.
    """

    fault: Fault
    arm: str
    joint: str
    time: float | None
    text: str


def find_faults(motion: Motion, rig: RigConfig) -> list[Problem]:
    """What is wrong with a motion of a rig; empty of a good one."""
    found = [*find_gaps(motion.times), *_time_unit(motion.times)]
    for arm, k in zip(motion.arms, rig.recorded, strict=True):
        robot = rig.arms[k].robot
        degrees = list(_degrees(arm, robot))
        found += degrees or [
            *_beyond_stops(motion.times, arm, robot),
            *_too_fast(motion.times, arm, robot),
            *_frozen(motion.times, arm, robot),
        ]
        found += _gripper(motion.times, arm, robot)
    return found + list(_swapped(motion))


def require_units(name: str, problems: Iterable[Problem]) -> None:
    """Make sure that a recording is not in other units than s and rad.

    Raises:
        DatasetError: it is; the text names the likely unit.
    """
    for problem in problems:
        if problem.fault in _WRONG_UNITS:
            raise DatasetError(f"{name}: {problem.text}")


def _time_unit(times: Array) -> Iterator[Problem]:
    if len(times) < 2:
        return
    usual = float(np.median(np.diff(times)))
    try:
        _PERIOD.check(usual)
    except ValueError as error:
        text = f"samples are {usual:g} s apart, which {error}"
        yield Problem(Fault.TIME_UNIT, "", "", None, text)


def find_gaps(times: Array, what: str = "nothing was recorded") -> Iterator[Problem]:
    """The gaps in times (n,) at which something was recorded.

    Args:
        what: is told of a gap, before how long it is.
    """
    if len(times) < 2:
        return
    pauses = np.diff(times)
    usual = float(np.median(pauses))
    for k in np.flatnonzero((pauses > _GAP_TIMES * usual) & (pauses > _GAP_S)):
        yield Problem(
            Fault.GAP,
            "",
            "",
            float(times[k]),
            f"{what} for {pauses[k]:.2f} s from {times[k]:.2f} s on, and elsewhere samples are "
            f"{usual * 1000:.1f} ms apart; split it there",
        )


def _degrees(arm: ArmMotion, robot: Robot) -> Iterator[Problem]:
    turned = arm.joints if arm.commands is None else np.vstack([arm.joints, arm.commands])
    most = np.nanmax(np.abs(turned), axis=0)
    if most.max() <= _NO_RADIANS:
        return
    k = int(np.argmax(most))
    name = robot.joint_names[k]
    yield Problem(
        Fault.DEGREES,
        arm.side,
        name,
        None,
        f"{_called(arm, name)} is at {most[k]:.3g}, which no joint turns to in rad; are these degrees?",
    )


def _beyond_stops(times: Array, arm: ArmMotion, robot: Robot) -> Iterator[Problem]:
    low, high = robot.joint_range.T
    beyond = np.fmax(low - arm.joints, arm.joints - high)
    for k, name in enumerate(robot.joint_names):
        if (most := np.nanmax(beyond[:, k])) > _BEYOND_STOPS:
            at = int(np.nanargmax(beyond[:, k]))
            yield Problem(
                Fault.BEYOND_STOPS,
                arm.side,
                name,
                float(times[at]),
                f"{_called(arm, name)} is at {arm.joints[at, k]:.3f} rad at {times[at]:.2f} s, {most:.3f} rad beyond "
                f"its stops ({low[k]:.3f} to {high[k]:.3f}); is it another model, or was its zero another one?",
            )


def _too_fast(times: Array, arm: ArmMotion, robot: Robot) -> Iterator[Problem]:
    known = ~np.isnan(arm.joints).any(axis=1)
    when, joints = times[known], arm.joints[known]
    speeds = np.abs(np.diff(joints, axis=0)) / np.diff(when)[:, None]
    for k, joint in enumerate(robot.joints):
        # Measurements jitter by a step of the encoder, which is fast from one sample to the next.
        fast = (speeds[:, k] > joint.reported_rad_s) & (np.abs(np.diff(joints[:, k])) > _MOTION)
        if fast.any():
            at = int(np.argmax(fast))
            yield Problem(
                Fault.TOO_FAST,
                arm.side,
                joint.name,
                float(when[at]),
                f"{_called(arm, joint.name)} jumps from {joints[at, k]:.3f} to {joints[at + 1, k]:.3f} rad at "
                f"{when[at]:.2f} s, faster than its drive can report ({joint.reported_rad_s:g} rad/s); were recordings "
                "joined, or samples lost?",
            )


def _frozen(times: Array, arm: ArmMotion, robot: Robot) -> Iterator[Problem]:
    if arm.commands is None:
        return
    known = ~np.isnan(arm.joints).any(axis=1)
    when, joints, commands = times[known], arm.joints[known], arm.commands[known]
    for k, name in enumerate(robot.joint_names):
        edges = np.flatnonzero(np.r_[True, np.diff(joints[:, k]) != 0, True])
        for first, end in itertools.pairwise(edges):
            told = commands[first:end, k]
            if when[end - 1] - when[first] >= _FROZEN_S and np.ptp(told) > _FROZEN_COMMAND:
                yield Problem(
                    Fault.FROZEN,
                    arm.side,
                    name,
                    float(when[first]),
                    f"{_called(arm, name)} was measured at exactly {joints[first, k]:.4f} rad for "
                    f"{when[end - 1] - when[first]:.2f} s from {when[first]:.2f} s on, while its command moved by "
                    f"{np.ptp(told):.2f} rad; was its bus silent?",
                )
                break


def _gripper(times: Array, arm: ArmMotion, robot: Robot) -> Iterator[Problem]:
    if arm.openings is None or robot.fingers is None:
        return
    widest = robot.fingers.range[1]
    known = ~np.isnan(arm.openings)
    measured = arm.openings[known]
    if measured.max() > _WIDER * widest:
        yield Problem(
            Fault.GRIPPER_SHARE,
            arm.side,
            "gripper",
            None,
            f"{_called(arm, 'gripper')} is at {measured.max():.3g}, and one finger opens by {widest:g} m; is it a "
            "share, or both fingers together?",
        )
        return
    if arm.commanded_openings is None:
        return
    told = arm.commanded_openings[known]
    if (
        min(np.ptp(told), np.ptp(measured)) > _SOME_OPENING * widest
        and (r := float(np.corrcoef(told, measured)[0, 1])) < _UPSIDE_DOWN
    ):
        yield Problem(
            Fault.GRIPPER_UPSIDE_DOWN,
            arm.side,
            "gripper",
            None,
            f"{_called(arm, 'gripper')} closes as it is told to open (correlation {r:.2f}): is one of them upside "
            "down?",
        )
    elif (stall := _stalled(times[known], measured / widest, told / widest)) is not None:
        yield Problem(
            Fault.GRIPPER_STALLS_OPENING,
            arm.side,
            "gripper",
            stall,
            f"{_called(arm, 'gripper')} stops short as it is told to open, from {stall:.2f} s on, and never as it is "
            "told to close, which is where things are in its way: is it upside down? If so, import it with "
            "--mirror-gripper both",
        )


def _stalled(times: Array, measured: Array, told: Array) -> float | None:
    """When fingers first stall as they are told to open; None if they never do, or also as they are told to close.

    Args:
        measured, told: openings (n,), as shares of the widest.
    """
    ahead = measured - told
    still = np.abs(np.gradient(measured, times)) < _SLOW
    stands = np.where(still & (np.abs(ahead) > _STALL), np.sign(ahead), 0)
    first_of: dict[float, float] = {}
    edges = np.flatnonzero(np.r_[True, np.diff(stands) != 0, True])
    for first, end in itertools.pairwise(edges):
        if stands[first] and times[end - 1] - times[first] >= _STALL_S:
            first_of.setdefault(float(stands[first]), float(times[first]))
    return first_of.get(-1.0) if 1.0 not in first_of else None


def _swapped(motion: Motion) -> Iterator[Problem]:
    if len(motion.arms) != 2:
        return
    left, right = motion.arms
    if left.commands is None or right.commands is None or left.joints.shape != right.joints.shape:
        return
    own = max(_apart(left.commands, left.joints), _apart(right.commands, right.joints))
    other = max(_apart(left.commands, right.joints), _apart(right.commands, left.joints))
    if own > _MOTION and own > _SWAPPED * other:
        yield Problem(
            Fault.SWAPPED_ARMS,
            "",
            "",
            None,
            f"each arm is where the other one was told to go: {own:.2f} rad from its own commands, {other:.2f} from "
            "the other's; are the arms swapped?",
        )


def _apart(commands: Array, joints: Array) -> float:
    return float(np.sqrt(np.nanmean((commands - joints) ** 2)))


def _called(arm: ArmMotion, joint: str) -> str:
    return f"{arm.side}_{joint}" if arm.side else joint
