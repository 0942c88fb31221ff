"""Imported recordings of real arms, to export."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from tests.real.recordings.foreign import write_lerobot_v2
from tests.real.recordings.making import write_csv
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.recorded_motion import RecordedMotion
from yamsim_cli.real.import_recording.importing import ImportRequest, import_recordings


def bring_in(out: Path, sources: list[Path], rig: RigConfig, locations: Locations) -> Path:
    """The dataset of some recordings."""
    import_recordings(ImportRequest(sources, rig, out=out), locations, lambda done, total: None)
    return out


def with_film(folder: Path, motion: RecordedMotion, rig: RigConfig, locations: Locations) -> Path:
    """A dataset of two arms, with commands, a video of one camera, and a prompt."""
    return bring_in(folder / "real", [write_lerobot_v2(folder / "lerobot", motion, rig)], rig, locations)


def of_tables(folder: Path, motions: list[RecordedMotion], rig: RigConfig, locations: Locations) -> Path:
    """A dataset of CSVs, without pictures and prompt."""
    files = [write_csv(folder / f"log{k}.csv", motion, rig) for k, motion in enumerate(motions)]
    return bring_in(folder / "tables", files, rig, locations)


def without_commands(motion: RecordedMotion) -> RecordedMotion:
    return replace(motion, arms=tuple(replace(arm, commands=None, commanded_openings=None) for arm in motion.arms))
