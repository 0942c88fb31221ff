"""The formats of recordings, by name; and which of them something is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from ..config.rig import RigConfig
from ..dataset.real import is_ours
from ..errors import DatasetError, UsageError, suggest
from ..resources import Locations
from .csv_file import read_csv
from .lerobot_files import is_lerobot, read_lerobot
from .lowdim_folder import read_lowdim
from .mcap_file import read_mcap
from .raiden_npz import ROBOT_DATA, read_raiden_raw
from .recording import Recording

Reader = Callable[[Path, RigConfig, str | None, Locations], list[Recording]]

FORMATS: Mapping[str, Reader] = {
    "csv": lambda path, rig, mapping, where: [Recording(read_csv(path, rig), "metres")],
    "raiden_raw": lambda path, rig, mapping, where: read_raiden_raw(path, rig),
    "lowdim": lambda path, rig, mapping, where: read_lowdim(path, rig),
    "lerobot": read_lerobot,
    "mcap": read_mcap,
}


def format_of(path: Path) -> str:
    """The format of a file or a folder.

    Raises:
        DatasetError: it is not there, or of none of them.
    """
    if not path.exists():
        raise DatasetError(f"{path} does not exist")
    if path.is_file():
        by_ending = {".csv": "csv", ".mcap": "mcap", ".npz": "raiden_raw"}
        if (found := by_ending.get(path.suffix.lower())) is not None:
            return found
    elif (path / ROBOT_DATA).is_file():
        return "raiden_raw"
    elif is_lerobot(path):
        return "lerobot"
    elif is_ours(path):
        raise DatasetError(f"{path}: is an episode or a dataset of yamsim's already, which needs no import")
    elif (path / "lowdim").is_dir() or any(path.glob("*/lowdim")):
        return "lowdim"
    raise DatasetError(
        f"{path}: is no recording that is known; valid: a .csv or .mcap, a robot_data.npz or its folder, a folder "
        "with rgb/ and lowdim/ or of such folders, a LeRobot dataset"
    )


def reader_of(name: str) -> Reader:
    """The reader of a format.

    Raises:
        UsageError: there is none of that name.
    """
    if name not in FORMATS:
        raise UsageError(f"--format {name!r} is not valid; {suggest(name, FORMATS)}")
    return FORMATS[name]
