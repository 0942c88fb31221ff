"""Motions as a well-behaved arm makes them, to be spoilt."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.motion import ArmMotion, Motion
from yamsim_cli.core.recordings.csv_file import csv_bytes, header
from yamsim_cli.core.recordings.recording import sides

RATE = 100.0


def swinging(rig: RigConfig, seconds: float = 4.0, lag: int = 3) -> Motion:
    """All joints swing about their starts, each at its own pace, and follow what they were told a few samples later."""
    times = np.arange(round(seconds * RATE)) / RATE
    arms = []
    for number, (side, k) in enumerate(zip(sides(rig), rig.recorded, strict=True)):
        robot = rig.arms[k].robot
        paces = 0.2 + 0.07 * np.arange(robot.dof) + 0.05 * number
        commands = np.array(robot.start) + 0.19 * np.sin(2 * np.pi * times[:, None] * paces)
        widest = robot.fingers.range[1] if robot.fingers else 0.0
        told = widest * (0.5 + 0.4 * np.sin(2 * np.pi * times * 0.3))
        arms.append(ArmMotion(side, later(commands, lag), commands, later(told, lag), told))
    return Motion("swinging", times, tuple(arms))


def write_csv(path: Path, motion: Motion, rig: RigConfig) -> Path:
    """A motion as a CSV that users bring; without commands where it has none."""
    rows = [
        np.column_stack(columns)
        for columns in (
            *((arm.commands, arm.commanded_openings) for arm in motion.arms),
            *((arm.joints, arm.openings) for arm in motion.arms),
        )
        if all(values is not None for values in columns)
    ]
    if any(arm.commands is None for arm in motion.arms):
        names = [name for name in header(rig) if not name.startswith("command")]
        np.savetxt(
            path, np.column_stack([motion.times, *rows]), "%.17g", delimiter=",", header=",".join(names), comments=""
        )
        return path
    path.write_bytes(csv_bytes(rig, motion.times, np.hstack(rows)))
    return path


def later(values: np.ndarray, samples: int) -> np.ndarray:
    """Values as they were some samples before, and the first one until then."""
    return np.concatenate([np.repeat(values[:1], samples, axis=0), values[: len(values) - samples]])
