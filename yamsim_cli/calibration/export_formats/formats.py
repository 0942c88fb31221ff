"""The formats of other programs in which a calibration is written."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ...core.config.rig import RigConfig
from ...core.errors import UsageError, suggest_similar
from ...core.files.resources import Locations
from ...export.output_directory import export_directory
from ..calibration_file import Calibration
from .format_files import FormatFiles
from .inspect_robots import write_inspect_robots
from .kalibr import write_kalibr
from .raiden import write_raiden
from .ros import write_ros

FORMATS: Mapping[str, Callable[[Calibration, RigConfig, Locations], FormatFiles]] = {
    "ros": write_ros,
    "kalibr": write_kalibr,
    "raiden": write_raiden,
    "inspect_robots": write_inspect_robots,
}
_CAMERA_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")  # names of files and ROS frames contain it


def require_formats(names: Sequence[str]) -> None:
    """Raise UsageError if there is no format of one of the names."""
    for name in names:
        if name not in FORMATS:
            raise UsageError(f"--format {name!r} is not valid; {suggest_similar(name, list(FORMATS))}")


def make_files(
    calibration: Calibration, rig: RigConfig, locations: Locations, formats: Sequence[str]
) -> dict[str, FormatFiles]:
    """Return the files of each of `formats`, or of all formats if it is empty.

    Raises UsageError if arms of the calibration are not the rig's, a camera is on an unknown arm, a camera's name
    cannot name a file, two cameras have the same name, one of `formats` does not fit the calibration, or none of all
    formats does.
    """
    _require_valid_names(calibration, rig)
    made = {name: FORMATS[name](calibration, rig, locations) for name in formats or FORMATS}
    empty = {name: one for name, one in made.items() if not one.files}
    if empty and (formats or len(empty) == len(made)):
        lines = "; ".join(line for one in empty.values() for line in one.left_out)
        raise UsageError(f"the calibration does not fit {', '.join(empty)}: {lines or 'it has no fixed cameras'}")
    return made


def _require_valid_names(calibration: Calibration, rig: RigConfig) -> None:
    calibration.for_rig(rig, "export calibration")
    left = rig.arms[rig.recording_order[0]].name
    if calibration.reference != left:
        raise UsageError(f"the calibration's reference is {calibration.reference!r}; it must be {left!r}, the left arm")
    arms = [arm.name for arm in calibration.arms]
    for camera in calibration.wrist_cameras:
        if camera.arm not in arms:
            hint = suggest_similar(camera.arm, arms)
            raise UsageError(f"the calibration's camera {camera.name!r} is on unknown arm {camera.arm!r}; {hint}")
    names = [camera.name for camera in (*calibration.cameras, *calibration.wrist_cameras)]
    for name in names:
        if not _CAMERA_NAME.fullmatch(name):
            raise UsageError(
                f"the calibration's camera {name!r}: give it letters, digits, _, - or ., the first one a "
                "letter or digit"
            )
        if names.count(name) > 1:
            raise UsageError(f"the calibration has several cameras {name!r}; rename one")


def write_files(made: Mapping[str, FormatFiles], out: Path, *, overwrite: bool) -> Path | None:
    """Write `out/FORMAT/FILE` of all formats, or nothing. Return the backup of an earlier `out`, if any."""
    with export_directory(out, overwrite=overwrite) as stage:
        for name, one in made.items():
            for file, text in one.files.items():
                path = stage.path / name / file
                path.parent.mkdir(exist_ok=True)
                path.write_text(text, encoding="utf-8")
    return stage.moved_aside
