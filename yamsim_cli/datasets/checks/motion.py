"""Check values over frames: even times, joints within motor limits, rigid poses, plausible cameras."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from yamsim_cli.core.dataset.checks.context import ArmLimits
from yamsim_cli.core.dataset.checks.problem import ProblemCollector
from yamsim_cli.core.geometry.camera import project_points
from yamsim_cli.core.geometry.se3 import Array, invert_pose
from yamsim_cli.core.robots.models import JointLimits

TIMESTAMPS_FILE = "timestamps.npy"  # file of capture times in `rgb/<camera>/` of converted real recordings
# Start of an `.npy` file, version 1.0, with a one-dimensional array of 64-bit integers. Source: numpy.lib.format.
_NPY_MAGIC = b"\x93NUMPY\x01\x00"
_NPY_HEADER = re.compile(rb"\{'descr': '([<>])i8', 'fortran_order': (?:True|False), 'shape': \((\d{1,9}),\), \} *\n")

# Largest deviation of the time between frames, as a share of the period.
_MAX_JITTER_RECORDED = 0.01  # with a recorded period: simulations keep it exactly
_MAX_JITTER_PLAIN = 0.5  # without a recorded period, as for real cameras, which jitter by milliseconds

# Tolerance beyond a joint limit: contacts in the simulation are soft, and encoders have an offset.
_LIMIT_SLACK_RAD = 0.05
_LIMIT_SLACK_M = 0.002

# Largest entry of R R^T - 1, and largest det R - 1, of a rotation. float32 leaves 1e-6; rounding to three digits, 1e-3.
_MAX_ROTATION_ERROR = 2e-3
_MAX_COORDINATE = 20.0  # m, largest position of a pose: larger than any room; millimetres read as metres exceed it
# Largest distance of a principal point from the image centre, as a share of width or height. Lenses are off by a few
# per cent, and a matrix for another image size by more than this limit.
_MAX_OFF_CENTRE = 0.1
_VALID_FOCAL_LENGTHS = (0.13, 10.0)  # valid range, as a share of the image width: fields of view of 150 to 6 deg

FramePathFunction = Callable[[int], str]  # frame number -> path of the frame's file


def check_times(
    times: Mapping[int, float], period: float | None, name: FramePathFunction, problems: ProblemCollector
) -> float | None:
    """Report times (frame number -> s) that do not increase or are uneven.

    Returns:
        `period` (recorded time between frames, s), else the median time between frames; None if neither is known.
    """
    steps = {k: (times[k] - times[k - 1]) for k in sorted(times) if k - 1 in times}
    if late := [k for k, step in steps.items() if step <= 0]:
        first = late[0]
        value = f"{times[first]:g} s after {times[first - 1]:g} s"
        for _ in late:
            problems.add("time.order", name(first), value, about="time")
        return period
    jitter = _MAX_JITTER_PLAIN if period is None else _MAX_JITTER_RECORDED
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
class ArmData:
    """Motion of one arm: frame number -> joint angles (n,) in rad, and frame number -> opening of one finger in m."""

    limits: ArmLimits
    joints: Mapping[int, Array]
    openings: Mapping[int, float]


def split_by_arm(joints: Mapping[int, Array], arms: Sequence[ArmLimits], *, repeated: bool) -> list[ArmData]:
    """Split the frames' `joints` by arm, and return the motion of each arm; empty if the length does not match.

    Args:
        joints: frame number -> joints and openings of all arms, one arm after the other.
        repeated: whether the number of arms is unknown. The first of `arms` is then repeated as often as it fits. A
            row of only its joints counts as one arm without its opening.
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


def angles_by_camera(camera: str, arms: Sequence[ArmData], wrists: Mapping[str, int]) -> dict[int, Array]:
    """Return frame number -> angles (n,), rad, of the arms whose motion the camera must show; empty without arms.

    A wrist camera is only required to show the motion of its own arm.

    Args:
        wrists: wrist camera -> index of its arm.
    """
    if not arms:
        return {}
    shown = [arms[wrists[camera]]] if camera in wrists else list(arms)
    return {k: np.concatenate([arm.joints[k] for arm in shown]) for k in shown[0].joints}


def check_limits(
    joints: Mapping[int, Array], limits: Sequence[JointLimits], name: FramePathFunction, problems: ProblemCollector
) -> None:
    """Report joints beyond their limits. `joints` is frame number -> angles (n,), rad."""
    for k, values in sorted(joints.items()):
        for value, joint in zip(values, limits, strict=True):
            low, high = joint.range
            if not low - _LIMIT_SLACK_RAD <= value <= high + _LIMIT_SLACK_RAD:
                text, valid = f"{joint.name} at {value:.3f} rad", f"{low:g} to {high:g} rad"
                problems.add("joints.limit", name(k), text, valid, about=joint.name)


def check_fingers(
    openings: Mapping[int, float], stops: tuple[float, float], name: FramePathFunction, problems: ProblemCollector
) -> None:
    """Report finger openings (m), by frame number, beyond their lower and upper limit `stops` (m)."""
    low, high = stops
    for k, value in sorted(openings.items()):
        if not low - _LIMIT_SLACK_M <= value <= high + _LIMIT_SLACK_M:
            text, valid = f"finger opened {value * 1000:.1f} mm", f"{low * 1000:g} to {high * 1000:g} mm"
            problems.add("joints.limit", name(k), text, valid, about="finger")


def check_speeds(
    joints: Mapping[int, Array],
    period: float | None,
    limits: Sequence[JointLimits],
    name: FramePathFunction,
    problems: ProblemCollector,
) -> None:
    """Report joints that move faster than the drive can report, or than the motor can turn.

    Args:
        joints: frame number -> angles (n,), rad.
        period: time between consecutive frames, s; None skips the check.
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
            code, valid = "joints.jump" if jump else "joints.fast", f"{what} at most {most:.1f} rad/s"
            problems.add(code, name(after), f"{value}, after frame {before}", valid, about=joint.name)


def read_timestamps(data: bytes) -> list[float] | None:
    """Return times in s since the first, from int64 nanoseconds in an `.npy`; None if `data` has another format.

    `numpy.load` is not used because it allocates the size that the header declares before it reads the bytes.
    """
    start = len(_NPY_MAGIC) + 2
    end = start + int.from_bytes(data[len(_NPY_MAGIC) : start], "little")
    header = _NPY_HEADER.fullmatch(data[start:end])
    if not data.startswith(_NPY_MAGIC) or not header or int(header[2]) * 8 != len(data) - end or end == len(data):
        return None
    times = np.frombuffer(data[end:], f"{header[1].decode()}i8")
    # Subtract as integers: a float holds nanoseconds since 1970 only to the nearest 0.2 microseconds.
    return [(int(time) - int(times[0])) * 1e-9 for time in times]


def check_pose(key: str, poses: Mapping[int, Array], name: FramePathFunction, problems: ProblemCollector) -> None:
    """Report poses (4, 4) of `key`, by frame number, that are not rigid transforms in metres."""
    numbers = sorted(poses)
    T = np.array([poses[k] for k in numbers], dtype=np.float64)
    if not len(T):
        return
    R = T[:, :3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        skewed = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
        determinant = np.linalg.det(R)
    for k, off, det, rows in zip(numbers, skewed, determinant, T, strict=True):
        if not off <= _MAX_ROTATION_ERROR or not abs(det - 1) <= _MAX_ROTATION_ERROR:
            value = f"{key}: R R^T is off by {off:.2g}, det R is {det:.3g}"
            problems.add("pose.rotation", name(k), value, "orthonormal, det R = 1", about=key)
        if not np.array_equal(rows[3], (0, 0, 0, 1)):
            value = f"{key}: {' '.join(f'{entry:g}' for entry in rows[3])}"
            problems.add("pose.row", name(k), value, about=key)
        if (distance := float(np.abs(rows[:3, 3]).max())) > _MAX_COORDINATE:
            problems.add("pose.far", name(k), f"{key}: {distance:.4g} m", f"within {_MAX_COORDINATE:g} m", about=key)


def check_intrinsics(
    key: str,
    matrices: Mapping[int, Array],
    size: tuple[int, int] | None,
    name: FramePathFunction,
    problems: ProblemCollector,
) -> None:
    """Report matrices (3, 3) of `key`, by frame number, that are not camera matrices or do not fit the image size."""
    for k, K in sorted(matrices.items()):
        (fx, skew, cx), (zero, fy, cy), last = np.asarray(K, dtype=np.float64)
        if skew or zero or not np.array_equal(last, (0, 0, 1)) or min(fx, fy) <= 0:
            rows = "; ".join(" ".join(f"{entry:g}" for entry in row) for row in K)
            problems.add("camera.intrinsics", name(k), f"{key}: {rows}", "fx 0 cx; 0 fy cy; 0 0 1", about=key)
            continue
        if size is None:
            continue
        width, height = size
        off_x, off_y = abs(cx - (width - 1) / 2) / width, abs(cy - (height - 1) / 2) / height
        if max(off_x, off_y) > _MAX_OFF_CENTRE:
            value = f"{key}: principal point {cx:.1f}, {cy:.1f} in {width}x{height}"
            problems.add("camera.fit", name(k), value, f"near {(width - 1) / 2:g}, {(height - 1) / 2:g}", about=key)
        elif not _VALID_FOCAL_LENGTHS[0] * width <= fx <= _VALID_FOCAL_LENGTHS[1] * width or not 0.8 <= fx / fy <= 1.25:
            value = f"{key}: focal length {fx:.4g}, {fy:.4g} px in {width}x{height}"
            valid = f"{_VALID_FOCAL_LENGTHS[0] * width:.0f} to {_VALID_FOCAL_LENGTHS[1] * width:.0f}, alike"
            problems.add("camera.fit", name(k), value, valid, about=key)


def check_objects_in_view(
    camera: str,
    values: Mapping[int, Mapping[str, Any]],
    points: Mapping[str, Mapping[int, Array]],
    size: tuple[int, int] | None,
    problems: ProblemCollector,
) -> None:
    """Report a camera whose images contain none of the positions of `points`: key -> frame number -> pose (4, 4).

    The extrinsics of such a camera are inverted or relative to a wrong frame. All poses must have passed `check_pose`.
    """
    if size is None or not points:
        return
    judged = False
    for k, frame in values.items():
        K, T_cam_in_base = frame.get(f"intrinsics[{camera}]"), frame.get(f"extrinsics[{camera}]")
        if K is None or T_cam_in_base is None or any(k not in by_frame for by_frame in points.values()):
            continue
        judged = True
        positions = np.array([by_frame[k][:, 3] for by_frame in points.values()], dtype=np.float64)
        in_cam = (invert_pose(T_cam_in_base) @ positions.T).T[:, :3]
        in_front = in_cam[in_cam[:, 2] > 0.01]
        if len(in_front):
            pixels = project_points(K, in_front)
            if bool(((pixels >= -0.5) & (pixels < np.array(size) - 0.5)).all(axis=1).any()):
                return
    if judged:
        valid = f"at least one in its {size[0]}x{size[1]} image"
        problems.add("camera.view", f"rgb/{camera}", ", ".join(points), valid)
