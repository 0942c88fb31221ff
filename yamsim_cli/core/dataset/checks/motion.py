"""Time and joints: that time goes on evenly, and that the arm moves as an arm can."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ...config.limits import JointLimits
from ...geometry.se3 import Array
from .problem import Problems

# How far a frame may be from its place, of a period: simulations keep it exactly, real cameras jitter by milliseconds.
_JITTER_RECORDED = 0.01
_JITTER_PLAIN = 0.5

# What a stop may be overrun by: contact in the simulation is soft, and encoders have an offset.
_LIMIT_SLACK_RAD = 0.05
_LIMIT_SLACK_M = 0.002

Named = Callable[[int], str]


def check_times(times: Mapping[int, float], period: float | None, name: Named, problems: Problems) -> float | None:
    """Note times that do not increase, and frames that are not where they should be.

    Args:
        times: frame -> s.
        period: between frames, s, as recorded; None where it is not known.
        name: a frame's file.

    Returns:
        The period, s: the recorded one or the median; None when it cannot be told.
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


def arm_joints(joints: Mapping[int, Array], limits: Sequence[JointLimits]) -> list[dict[int, Array]]:
    """Frame -> the joints (n,) of one arm, for each arm in a frame's `joints`; none if they are of no known order.

    An arm has its joints and then its gripper; two arms come one after the other, the left one first.
    """
    n = len(limits)
    length = next((len(values) for values in joints.values() if values.ndim == 1), 0)
    starts = [0] if length == n else [*range(0, length, n + 1)] if length and length % (n + 1) == 0 else []
    return [{k: values[start : start + n] for k, values in joints.items()} for start in starts]


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
    """Note joints that move faster than their drive could report, or than their motor turns.

    Args:
        joints: frame -> angles (n,), rad.
        period: between consecutive frames, s; without it nothing can be said.
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
