"""Checks that time goes on evenly, and that the arm moves as an arm can."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...geometry.se3 import Array
from ...robots.models import JointLimits
from .problem import Problems

# How far the time between frames may be off, as a share of the period. Simulations keep it exactly, and real cameras
# jitter by milliseconds.
_JITTER_RECORDED = 0.01
_JITTER_PLAIN = 0.5

# How far a joint may be beyond its stop: contacts in the simulation are soft, and encoders have an offset.
_LIMIT_SLACK_RAD = 0.05
_LIMIT_SLACK_M = 0.002

Named = Callable[[int], str]


def check_times(times: Mapping[int, float], period: float | None, name: Named, problems: Problems) -> float | None:
    """The time between frames, s: the recorded one or the median, or None if neither is known.

    Times that do not increase, and uneven ones, are noted.

    Args:
        times: frame -> time, s.
        period: recorded time between frames, s; None where it is not known.
        name: the name of a frame's file.
    """
    steps = {k: (times[k] - times[k - 1]) for k in sorted(times) if k - 1 in times}
    if late := [k for k, step in steps.items() if step <= 0]:
        first = late[0]
        value = f"{times[first]:g} s after {times[first - 1]:g} s"
        for _ in late:
            problems.add("time.order", name(first), value, about="time")
        return period
    jitter = _JITTER_PLAIN if period is None else _JITTER_RECORDED
    if period is None:
        period = float(np.median(list(steps.values()))) if steps else None
    if period is None:
        return None
    for k, step in steps.items():
        if abs(step - period) > jitter * period:
            value, valid = f"{step * 1000:.1f} ms after the frame before", f"{period * 1000:.1f} ms"
            problems.add("time.spacing", name(k), value, valid, about="time")
    return period


@dataclass(frozen=True)
class ArmLimits:
    """What an arm can do.

    Attributes:
        joints: from the base to the flange.
        drives: how many numbers it has in a row of the data: its joints, and its fingers' opening if it has fingers.
        fingers: stops of one finger, m; None where they are not known.
    """

    joints: tuple[JointLimits, ...]
    drives: int
    fingers: tuple[float, float] | None


@dataclass(frozen=True)
class ArmData:
    """One arm's part of an episode's `joints`: frame -> angles (n,) in rad, and frame -> opening of one finger in m."""

    limits: ArmLimits
    joints: Mapping[int, Array]
    openings: Mapping[int, float]


def each_arm(joints: Mapping[int, Array], arms: Sequence[ArmLimits], *, repeated: bool) -> list[ArmData]:
    """Every arm's part of the frames' `joints`; none if they are of no known order.

    Args:
        joints: frame -> all arms' joints and openings, one arm's after the other's.
        repeated: how many arms there are is not known: as many of the first as there are numbers for; or it alone,
            without its opening.
    """
    length = next((len(values) for values in joints.values() if values.ndim == 1), 0)
    first = arms[0]
    if repeated and length == len(first.joints):
        arms = [replace(first, drives=length)]
    elif repeated:
        arms = [first] * (length // first.drives)
    if not arms or length != sum(arm.drives for arm in arms):
        return []
    found, start = [], 0
    for arm in arms:
        n = len(arm.joints)
        openings = {k: float(values[start + n]) for k, values in joints.items()} if arm.drives > n else {}
        found.append(ArmData(arm, {k: values[start : start + n] for k, values in joints.items()}, openings))
        start += arm.drives
    return found


def angles_shown(camera: str, arms: Sequence[ArmData], wrists: Mapping[str, int]) -> dict[int, Array]:
    """Frame -> angles (n,) of the arms whose motion a camera's pictures have to show, rad; empty without arms.

    A camera at a wrist sees the same while its own arm stands still, whatever another one does.

    Args:
        wrists: camera -> number of the arm that carries it.
    """
    if not arms:
        return {}
    shown = [arms[wrists[camera]]] if camera in wrists else list(arms)
    return {k: np.concatenate([arm.joints[k] for arm in shown]) for k in shown[0].joints}


def check_limits(joints: Mapping[int, Array], limits: Sequence[JointLimits], name: Named, problems: Problems) -> None:
    """Note joints beyond their stops. `joints` is frame -> angles (n,), rad."""
    for k, values in sorted(joints.items()):
        for value, joint in zip(values, limits, strict=True):
            low, high = joint.range
            if not low - _LIMIT_SLACK_RAD <= value <= high + _LIMIT_SLACK_RAD:
                text, valid = f"{joint.name} at {value:.3f} rad", f"{low:g} to {high:g} rad"
                problems.add("joints.limit", name(k), text, valid, about=joint.name)


def check_fingers(openings: Mapping[int, float], stops: tuple[float, float], name: Named, problems: Problems) -> None:
    """Note finger openings (m) beyond their stops."""
    low, high = stops
    for k, value in sorted(openings.items()):
        if not low - _LIMIT_SLACK_M <= value <= high + _LIMIT_SLACK_M:
            text, valid = f"finger opened {value * 1000:.1f} mm", f"{low * 1000:g} to {high * 1000:g} mm"
            problems.add("joints.limit", name(k), text, valid, about="finger")


def check_speeds(
    joints: Mapping[int, Array], period: float | None, limits: Sequence[JointLimits], name: Named, problems: Problems
) -> None:
    """Note joints that move faster than their drive can report, or than their motor can turn.

    Args:
        joints: frame -> angles (n,), rad.
        period: time between consecutive frames, s; without it nothing is checked.
    """
    if not period or len(joints) < 2:
        return
    frames = sorted(joints)
    angles = np.array([joints[k] for k in frames], dtype=np.float64)
    speeds = np.abs(np.diff(angles, axis=0)) / (np.diff(frames)[:, None] * period)
    for column, joint in enumerate(limits):
        over = np.flatnonzero(speeds[:, column] > joint.motor_rad_s)
        for row in over:
            speed = speeds[row, column]
            jump = speed > joint.reported_rad_s
            most, what = (joint.reported_rad_s, "the drive reports") if jump else (joint.motor_rad_s, "the motor turns")
            before, after = frames[row], frames[row + 1]
            value = f"{joint.name} by {abs(angles[row + 1, column] - angles[row, column]):.3f} rad, {speed:.1f} rad/s"
            code = "joints.jump" if jump else "joints.fast"
            problems.add(
                code,
                name(after),
                f"{value}, after frame {before}",
                f"{what} at most {most:.1f} rad/s",
                about=joint.name,
            )
