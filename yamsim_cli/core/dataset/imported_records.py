"""Records and config of imported recordings of real arms."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from ..config.loader import parse_config
from ..config.real_recordings import RealConfig
from ..errors import ConfigError, DatasetError
from ..files.documents.yaml_document import parse_yaml
from ..files.resources import Locations
from .dataset_paths import CONFIG, EPISODE, EPISODE_FORMAT, REAL_FORMAT_VERSION
from .records import CameraSizes, FilePath, Record

REAL = "real"  # value of `source` in the config and records of imported recordings


class ImportedFrom(Record):
    """Source of an imported recording: name of its file format, and name of its file or folder."""

    format: str
    name: str


class RealEpisodeRecord(Record):
    """`episode.json` of an imported recording.

    Attributes:
        frame_period_s: typical time between frames, s. Each frame also has its own `timestamp`.
        drives: number of measured drives per arm, without the gripper if the gripper was not recorded.
        problems: faults that the import found, one sentence each.
    """

    format: Annotated[str, Field(pattern=f"^{EPISODE_FORMAT}$")] = EPISODE_FORMAT
    format_version: int = REAL_FORMAT_VERSION
    episode: int
    source: Literal["real"] = "real"
    imported: ImportedFrom
    rig: str
    frames: Annotated[int, Field(ge=1)]
    frame_period_s: Annotated[float, Field(gt=0)]
    cameras: CameraSizes
    arms: Annotated[int, Field(ge=1, le=2)]
    drives: Annotated[int, Field(ge=1, le=64)]
    prompt: str = ""
    problems: tuple[str, ...] = ()
    versions: dict[str, str]
    content_sha256: str
    files: dict[FilePath, str]


def is_real(dataset: Path) -> bool:
    """Return whether the config of a dataset says that its episodes are imported recordings."""
    try:
        data = parse_yaml((dataset / CONFIG).read_text(encoding="utf-8"), str(dataset / CONFIG)).data
    except (OSError, UnicodeDecodeError, ConfigError):
        return False
    return data.get("source") == REAL


def is_yamsim_data(path: Path) -> bool:
    """Return whether a folder is an episode or a dataset in yamsim's format."""
    return (path / EPISODE).is_file() or (path / CONFIG).is_file()


def real_config(dataset: Path, locations: Locations) -> RealConfig:
    """Return the config of a dataset of imported recordings. Raise DatasetError if it is unreadable or invalid."""
    file = dataset / CONFIG
    try:
        return parse_config(RealConfig, file.read_text(encoding="utf-8"), str(file), locations, as_recorded=True)
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"{file} cannot be read: {error}") from error
    except ConfigError as error:
        raise DatasetError(f"{error}; was it imported by another version of yamsim?") from error
