"""Imported recordings of real arms, to export."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.core.recordings.foreign import write_lerobot_v2
from tests.core.recordings.making import write_csv
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.import_recording.importing import ImportRequest, import_recordings
from yamsim_cli.core.motion import ArmMotion, Motion
from yamsim_cli.core.resources import Locations

NAMES = [f"{side}_{what}" for side in ("left", "right") for what in (*[f"joint_{k}" for k in range(1, 7)], "gripper")]


def bring_in(out: Path, sources: list[Path], rig: RigConfig, locations: Locations) -> Path:
    """The dataset of some recordings."""
    import_recordings(ImportRequest(sources, rig, out=out), locations, lambda done, total: None)
    return out


def with_film(folder: Path, motion: Motion, rig: RigConfig, locations: Locations) -> Path:
    """Of a station with two arms: commands, a film of one camera, and words."""
    return bring_in(folder / "real", [write_lerobot_v2(folder / "lerobot", motion, rig, NAMES)], rig, locations)


def of_tables(folder: Path, motions: list[Motion], rig: RigConfig, locations: Locations) -> Path:
    """Of CSVs: no pictures, no words."""
    files = [write_csv(folder / f"log{k}.csv", motion, rig) for k, motion in enumerate(motions)]
    return bring_in(folder / "tables", files, rig, locations)


def without_commands(motion: Motion) -> Motion:
    """As a robot records itself that says nothing of what it was told."""
    arms = tuple(replace(arm, commands=None, commanded_openings=None) for arm in motion.arms)
    return replace(motion, arms=arms)


def some(motion: Motion, kept: np.ndarray) -> Motion:
    """Some samples of a motion."""

    def taken(values: np.ndarray | None) -> np.ndarray | None:
        return None if values is None else values[kept]

    arms = tuple(
        ArmMotion(
            arm.side,
            arm.joints[kept],
            taken(arm.commands),
            taken(arm.openings),
            taken(arm.commanded_openings),
            taken(arm.velocities),
        )
        for arm in motion.arms
    )
    return Motion(motion.name, motion.times[kept] - motion.times[kept][0], arms)
