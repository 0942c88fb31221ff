"""Records and config of imported recordings of real arms."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, TypeVar

from pydantic import Field

from ..config.loader import parse_config
from ..config.real_recordings import RealConfig
from ..errors import ConfigError, DatasetError
from ..files.documents.config_base import Config
from ..files.documents.yaml_document import parse_yaml
from ..files.resources import Locations
from .dataset_paths import CONFIG_FILE, EPISODE_FILE, EPISODE_FORMAT, FORMAT_VERSION
from .records import CameraSizes, FilePath, Record
from .upgrade import upgrade_config, upgrade_episode

C = TypeVar("C", bound=Config)

REAL_SOURCE = "real"  # value of `source` in the config and records of imported recordings


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

    upgrade = staticmethod(upgrade_episode)
    format: Annotated[str, Field(pattern=f"^{EPISODE_FORMAT}$")] = EPISODE_FORMAT
    format_version: int = FORMAT_VERSION
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


def is_imported_dataset(dataset: Path) -> bool:
    """Return whether the config of a dataset states that its episodes are imported recordings."""
    try:
        data = parse_yaml((dataset / CONFIG_FILE).read_text(encoding="utf-8"), str(dataset / CONFIG_FILE)).data
    except (OSError, UnicodeDecodeError, ConfigError):
        return False
    return data.get("source") == REAL_SOURCE


def is_yamsim_data(path: Path) -> bool:
    """Return whether a folder is an episode or a dataset in yamsim's format."""
    return (path / EPISODE_FILE).is_file() or (path / CONFIG_FILE).is_file()


def read_imported_config(dataset: Path, locations: Locations) -> RealConfig:
    """Return the config of imported recordings. Raises as `read_dataset_config`."""
    return read_dataset_config(RealConfig, dataset, locations)


def read_dataset_config(model: type[C], dataset: Path, locations: Locations) -> C:
    """Return the config of a dataset of any known format version.

    The plausible bounds of quantities are not checked: they may have changed since, and the dataset exists with its
    values. Raise DatasetError if the config is unreadable or invalid.
    """
    file = dataset / CONFIG_FILE
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8"
        raise DatasetError(
            f"{file} cannot be read ({reason}): without it, the dataset cannot be simulated again; restore it from a "
            "copy"
        ) from error
    try:
        return parse_config(model, text, str(file), locations, upgrade=upgrade_config)
    except ConfigError as error:
        raise DatasetError(f"{error}; was it made by another version of yamsim?") from error
