"""Find faults of recorded motions: gaps, wrong units, swapped arms, mirrored grippers."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.files.documents.units import QuantityBounds
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.recorded_motion import ArmMotion, RecordedMotion
from yamsim_cli.core.robots.robot import Robot

# A gap exceeds both a multiple of the median pause, and a time, s.
_GAP_FACTOR, _GAP_SECONDS = 5.0, 0.1
_LIMIT_TOLERANCE = 0.1  # rad; arms are calibrated to a degree or two
_MAX_ANGLE = 2 * math.pi  # rad; no joint turns farther, so larger values are degrees
_PERIOD_BOUNDS = QuantityBounds("s", 1e-5, 0.5)  # median step, 100 kHz to 2 Hz; times in ms exceed it
_MIN_MOTION = 0.05  # rad; smaller changes are noise
_SWAPPED_FACTOR = 3.0  # commands that fit the other arm's joints by this factor better are swapped
_OPENING_FACTOR = 1.1  # multiple of the fingers' range; larger openings are not in metres
# A joint is frozen if its measurement rests this long, s, while its command moves this far, rad.
_FROZEN_SECONDS, _FROZEN_COMMAND = 1.0, 0.1
_MAX_MIRRORED_CORRELATION = -0.5  # correlation of openings with commands, below which one is mirrored
_MIN_OPENING = 0.2  # share of the fingers' range; smaller motions have no correlation
# Fingers stall if they rest this long, s, this far from their command, shares of their range.
_STALL_SECONDS, _STALL_DISTANCE = 0.5, 0.2
_STILL_SPEED = 0.2  # shares of the range per s; slower fingers rest; encoder noise is half of it


class MotionFault(StrEnum):
    """A fault of a recorded motion."""

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


_WRONG_UNITS = (MotionFault.DEGREES, MotionFault.TIME_UNIT)


@dataclass(frozen=True)
class MotionProblem:
    """A fault with a line of text: joint, value and advice. `time` is its beginning, s; None for the whole motion."""

    fault: MotionFault
    text: str
    time: float | None = None


def find_faults(motion: RecordedMotion, rig: RigConfig) -> list[MotionProblem]:
    """Return all faults of a motion of a rig."""
    found = [*find_gaps(motion.times), *_time_unit_faults(motion.times)]
    for arm, k in zip(motion.arms, rig.recording_order, strict=True):
        robot = rig.arms[k].robot
        found += list(_degree_faults(arm, robot)) or [
            *_beyond_stops_faults(motion.times, arm, robot),
            *_too_fast_faults(motion.times, arm, robot),
            *_frozen_joint_faults(motion.times, arm, robot),
        ]
        found += _gripper_faults(motion.times, arm, robot)
    return found + list(_swapped_arms_faults(motion))


def require_units(name: str, problems: Iterable[MotionProblem]) -> None:
    """Check that times are in s and joints in rad, by the result of `find_faults`.

    Raises:
        DatasetError: a problem is a wrong unit.
    """
    for problem in problems:
        if problem.fault in _WRONG_UNITS:
            raise DatasetError(f"{name}: {problem.text}")


def _time_unit_faults(times: Array) -> Iterator[MotionProblem]:
    if len(times) < 2:
        return
    usual = float(np.median(np.diff(times)))
    try:
        _PERIOD_BOUNDS.check(usual)
    except ValueError as error:
        yield MotionProblem(MotionFault.TIME_UNIT, f"samples are {usual:g} s apart, which {error}")


def find_gaps(times: Array, what: str = "nothing was recorded") -> Iterator[MotionProblem]:
    """Yield gaps between times (n,), s; each text has `what` and the gap's length."""
    if len(times) < 2:
        return
    pauses = np.diff(times)
    usual = float(np.median(pauses))
    for k in np.flatnonzero((pauses > _GAP_FACTOR * usual) & (pauses > _GAP_SECONDS)):
        text = (
            f"{what} for {pauses[k]:.2f} s from {times[k]:.2f} s on, and elsewhere samples are "
            f"{usual * 1000:.1f} ms apart; split it there"
        )
        yield MotionProblem(MotionFault.GAP, text, float(times[k]))


def _degree_faults(arm: ArmMotion, robot: Robot) -> Iterator[MotionProblem]:
    turned = arm.joints if arm.commands is None else np.vstack([arm.joints, arm.commands])
    most = np.nanmax(np.abs(turned), axis=0)
    k = int(np.argmax(most))
    if most[k] > _MAX_ANGLE:
        name = _arm_and_joint_name(arm, robot.joint_names[k])
        text = f"{name} is at {most[k]:.3g}, which no joint reaches in rad; are these degrees?"
        yield MotionProblem(MotionFault.DEGREES, text)


def _beyond_stops_faults(times: Array, arm: ArmMotion, robot: Robot) -> Iterator[MotionProblem]:
    low, high = robot.joint_range.T
    beyond = np.fmax(low - arm.joints, arm.joints - high)
    for k, name in enumerate(robot.joint_names):
        if (most := np.nanmax(beyond[:, k])) > _LIMIT_TOLERANCE:
            at = int(np.nanargmax(beyond[:, k]))
            text = (
                f"{_arm_and_joint_name(arm, name)} is at {arm.joints[at, k]:.3f} rad at {times[at]:.2f} s, {most:.3f} "
                f"rad beyond its limits ({low[k]:.3f} to {high[k]:.3f}); is its model or its zero position different?"
            )
            yield MotionProblem(MotionFault.BEYOND_STOPS, text, float(times[at]))


def _too_fast_faults(times: Array, arm: ArmMotion, robot: Robot) -> Iterator[MotionProblem]:
    known = ~np.isnan(arm.joints).any(axis=1)
    when, joints = times[known], arm.joints[known]
    speeds = np.abs(np.diff(joints, axis=0)) / np.diff(when)[:, None]
    for k, joint in enumerate(robot.joints):
        # Encoder noise between two samples is fast but small.
        fast = (speeds[:, k] > joint.reported_rad_s) & (np.abs(np.diff(joints[:, k])) > _MIN_MOTION)
        if fast.any():
            at = int(np.argmax(fast))
            text = (
                f"{_arm_and_joint_name(arm, joint.name)} jumps from {joints[at, k]:.3f} to {joints[at + 1, k]:.3f} rad "
                f"at {when[at]:.2f} s, faster than its drive can report ({joint.reported_rad_s:g} rad/s); were "
                "recordings joined, or samples lost?"
            )
            yield MotionProblem(MotionFault.TOO_FAST, text, float(when[at]))


def _frozen_joint_faults(times: Array, arm: ArmMotion, robot: Robot) -> Iterator[MotionProblem]:
    if arm.commands is None:
        return
    known = ~np.isnan(arm.joints).any(axis=1)
    when, joints, commands = times[known], arm.joints[known], arm.commands[known]
    for k, name in enumerate(robot.joint_names):
        edges = np.flatnonzero(np.r_[True, np.diff(joints[:, k]) != 0, True])
        for first, end in itertools.pairwise(edges):
            seconds, moved = when[end - 1] - when[first], np.ptp(commands[first:end, k])
            if seconds >= _FROZEN_SECONDS and moved > _FROZEN_COMMAND:
                text = (
                    f"{_arm_and_joint_name(arm, name)} was measured at exactly {joints[first, k]:.4f} rad for "
                    f"{seconds:.2f} s from {when[first]:.2f} s on, while its command moved by {moved:.2f} rad; was its "
                    "bus silent?"
                )
                yield MotionProblem(MotionFault.FROZEN, text, float(when[first]))
                break


def _gripper_faults(times: Array, arm: ArmMotion, robot: Robot) -> Iterator[MotionProblem]:
    if arm.openings is None or robot.fingers is None:
        return
    name, widest = _arm_and_joint_name(arm, "gripper"), robot.fingers.range[1]
    known = ~np.isnan(arm.openings)
    measured = arm.openings[known]
    if measured.max() > _OPENING_FACTOR * widest:
        text = (
            f"{name} is at {measured.max():.3g}, and one finger opens by {widest:g} m; is it a share, or both fingers "
            "together?"
        )
        yield MotionProblem(MotionFault.GRIPPER_SHARE, text)
    elif arm.commanded_openings is not None:
        yield from _mirrored_gripper_faults(
            name, times[known], measured / widest, arm.commanded_openings[known] / widest
        )


def _mirrored_gripper_faults(name: str, times: Array, measured: Array, commanded: Array) -> Iterator[MotionProblem]:
    """Yield a fault if openings (n,), shares of the range, seem counted from the other end."""
    if (
        min(np.ptp(commanded), np.ptp(measured)) > _MIN_OPENING
        and (r := float(np.corrcoef(commanded, measured)[0, 1])) < _MAX_MIRRORED_CORRELATION
    ):
        text = f"{name} closes while commanded to open (correlation {r:.2f}): is one of the two signals inverted?"
        yield MotionProblem(MotionFault.GRIPPER_UPSIDE_DOWN, text)
    elif (stall := _first_opening_stall(times, measured, commanded)) is not None:
        text = (
            f"{name} stops short while commanded to open, from {stall:.2f} s on, and never while commanded to close, "
            "when objects can be in its way: is its signal inverted? If so, import it with --mirror-gripper both"
        )
        yield MotionProblem(MotionFault.GRIPPER_STALLS_OPENING, text, stall)


def _first_opening_stall(times: Array, measured: Array, commanded: Array) -> float | None:
    """Return when fingers first stall while opening, s; None if never, or if they stall while closing."""
    ahead = measured - commanded
    still = np.abs(np.gradient(measured, times)) < _STILL_SPEED
    stalls = np.where(still & (np.abs(ahead) > _STALL_DISTANCE), np.sign(ahead), 0)
    first_of: dict[float, float] = {}
    edges = np.flatnonzero(np.r_[True, np.diff(stalls) != 0, True])
    for first, end in itertools.pairwise(edges):
        if stalls[first] and times[end - 1] - times[first] >= _STALL_SECONDS:
            first_of.setdefault(float(stalls[first]), float(times[first]))
    return first_of.get(-1.0) if 1.0 not in first_of else None


def _swapped_arms_faults(motion: RecordedMotion) -> Iterator[MotionProblem]:
    if len(motion.arms) != 2:
        return
    left, right = motion.arms
    if left.commands is None or right.commands is None or left.joints.shape != right.joints.shape:
        return
    own = max(_rms(left.commands - left.joints), _rms(right.commands - right.joints))
    other = max(_rms(left.commands - right.joints), _rms(right.commands - left.joints))
    if own > _MIN_MOTION and own > _SWAPPED_FACTOR * other:
        text = (
            f"each arm is where the other arm was commanded to go: {own:.2f} rad from its own commands, {other:.2f} "
            "from the other's; are the arms swapped?"
        )
        yield MotionProblem(MotionFault.SWAPPED_ARMS, text)


def _rms(errors: Array) -> float:
    return float(np.sqrt(np.nanmean(errors**2)))


def _arm_and_joint_name(arm: ArmMotion, joint: str) -> str:
    return f"{arm.side}_{joint}" if arm.side else joint
