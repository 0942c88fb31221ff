"""Motions of well-behaved arms, and CSVs of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.recorded_motion import ArmMotion, RecordedMotion
from yamsim_cli.real.recordings.csv_file import csv_columns, encode_csv
from yamsim_cli.real.recordings.recording import motion_sides

RATE = 100.0


def swinging(rig: RigConfig, seconds: float = 4.0, lag: int = 3) -> RecordedMotion:
    """Each joint swings about its start at its own rate, and follows its commands `lag` samples later."""
    times = np.arange(round(seconds * RATE)) / RATE
    arms = []
    for number, (side, k) in enumerate(zip(motion_sides(rig), rig.recording_order, strict=True)):
        robot = rig.arms[k].robot
        paces = 0.2 + 0.07 * np.arange(robot.dof) + 0.05 * number
        commands = np.array(robot.start) + 0.19 * np.sin(2 * np.pi * times[:, None] * paces)
        widest = robot.fingers.range[1] if robot.fingers else 0.0
        openings = widest * (0.5 + 0.4 * np.sin(2 * np.pi * times * 0.3))
        arms.append(ArmMotion(side, later(commands, lag), commands, later(openings, lag), openings))
    return RecordedMotion("swinging", times, tuple(arms))


def write_csv(path: Path, motion: RecordedMotion, rig: RigConfig) -> Path:
    """Write a motion as a CSV, without commands if it has none."""
    rows = [
        np.column_stack(columns)
        for columns in (
            *((arm.commands, arm.commanded_openings) for arm in motion.arms),
            *((arm.joints, arm.openings) for arm in motion.arms),
        )
        if all(values is not None for values in columns)
    ]
    if any(arm.commands is None for arm in motion.arms):
        names = [name for name in csv_columns(rig) if not name.startswith("command")]
        np.savetxt(
            path, np.column_stack([motion.times, *rows]), "%.17g", delimiter=",", header=",".join(names), comments=""
        )
        return path
    path.write_bytes(encode_csv(rig, motion.times, np.hstack(rows)))
    return path


def later(values: np.ndarray, samples: int) -> np.ndarray:
    """Values `samples` rows later; the first row repeats."""
    return np.concatenate([np.repeat(values[:1], samples, axis=0), values[: len(values) - samples]])


def some(motion: RecordedMotion, kept: np.ndarray) -> RecordedMotion:
    """Some samples of a motion, with times from 0."""
    keys = ("joints", "commands", "openings", "commanded_openings", "velocities")
    arms = []
    for arm in motion.arms:
        values = {key: getattr(arm, key) for key in keys}
        arms.append(replace(arm, **{key: rows[kept] for key, rows in values.items() if rows is not None}))
    return RecordedMotion(motion.name, motion.times[kept] - motion.times[kept][0], tuple(arms))


def same_motion(found: RecordedMotion, truth: RecordedMotion, atol: float = 1e-6) -> None:
    """Times, joints, commands and openings are equal."""
    np.testing.assert_allclose(found.times, truth.times, atol=atol)
    for arm, other in zip(found.arms, truth.arms, strict=True):
        assert arm.side == other.side
        for key in ("joints", "commands", "openings", "commanded_openings"):
            np.testing.assert_allclose(getattr(arm, key), getattr(other, key), atol=atol, err_msg=key)


def frozen(first: int, joint: int) -> Callable[[Array], Array]:
    def spoil(joints: Array) -> Array:
        joints[first:, joint] = joints[first, joint]
        return joints

    return spoil


def full_opening(rig: RigConfig) -> float:
    fingers = rig.arms[rig.recording_order[0]].robot.fingers
    assert fingers is not None
    return fingers.full_opening


def with_gap(motion: RecordedMotion, full: float) -> RecordedMotion:
    kept = np.r_[0:60, 130:200]
    return replace(some(motion, kept), times=motion.times[kept])


def swapped(motion: RecordedMotion, full: float) -> RecordedMotion:
    arms = zip(motion.arms, reversed(motion.arms), strict=True)
    return replace(
        motion, arms=tuple(replace(arm, joints=other.joints, openings=other.openings) for arm, other in arms)
    )


def in_degrees(motion: RecordedMotion, full: float) -> RecordedMotion:
    arms = [
        replace(arm, joints=np.rad2deg(arm.joints), commands=np.rad2deg(arm.commands))  # type: ignore[arg-type]
        for arm in motion.arms
    ]
    return replace(motion, arms=tuple(arms))


def upside_down(motion: RecordedMotion, full: float) -> RecordedMotion:
    arms = [replace(arm, openings=full - arm.openings) for arm in motion.arms]  # type: ignore[operator]
    return replace(motion, arms=tuple(arms))


def froze(motion: RecordedMotion, full: float) -> RecordedMotion:
    left, right = motion.arms
    return replace(motion, arms=(left, replace(right, joints=frozen(50, 2)(right.joints.copy()))))
