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
from .content import FormatFiles, require_known_arm
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


def require_formats(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names without repetitions, all formats for none. Raise UsageError for an unknown one."""
    for name in names:
        if name not in FORMATS:
            raise UsageError(f"--format {name!r} is not valid; {suggest_similar(name, list(FORMATS))}")
    return tuple(dict.fromkeys(names)) or tuple(FORMATS)


def make_files(
    calibration: Calibration, rig: RigConfig, locations: Locations, formats: Sequence[str]
) -> dict[str, FormatFiles]:
    """Return the files of each format.

    Raises UsageError if arms of the calibration are not the rig's, a camera's name cannot name a file, two cameras
    have one name, or no format fits the calibration.
    """
    _require_valid_names(calibration, rig)
    made = {name: FORMATS[name](calibration, rig, locations) for name in formats}
    if not any(one.files for one in made.values()):
        lines = "; ".join(line for one in made.values() for line in one.left_out)
        raise UsageError(f"the calibration fits none of {', '.join(formats)}: {lines or 'it has no cameras'}")
    return made


def _require_valid_names(calibration: Calibration, rig: RigConfig) -> None:
    in_rig, in_file = [arm.name for arm in rig.arms], [arm.name for arm in calibration.arms]
    for name in in_file:
        require_known_arm(name, in_rig, f"rig {rig.name!r}")
    for name in (calibration.reference, *(camera.arm for camera in calibration.wrist_cameras)):
        require_known_arm(name, in_file, "its `arms`")
    names = [camera.name for camera in (*calibration.cameras, *calibration.wrist_cameras)]
    for name in names:
        if not _CAMERA_NAME.fullmatch(name):
            raise UsageError(f"the calibration's camera {name!r}: its name must be letters, digits, _, - and .")
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
