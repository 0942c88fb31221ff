"""Motions from whatever holds them: a CSV, an episode, or all episodes of a dataset."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..config.rig import RigConfig
from ..dataset.layout import EPISODE
from ..dataset.reader import open_episode, open_episodes
from ..errors import DatasetError, UsageError
from ..motion import Motion
from .csv_file import read_csv
from .episodes import read_episode

_VALID = "a .csv, an episode's directory, or a dataset's"


def read_motions(recordings: Sequence[Path], rig: RigConfig) -> list[Motion]:
    """The motions of recordings, in order; those of a dataset are all its episodes'.

    Raises:
        DatasetError: one is not there, cannot be read, is damaged or of another rig.
        UsageError: there is none.
    """
    motions: list[Motion] = []
    for path in recordings:
        if not path.exists():
            raise DatasetError(f"{path} does not exist; give {_VALID}")
        if path.is_dir():
            stored = [open_episode(path)] if (path / EPISODE).exists() else open_episodes(path)
            motions += [read_episode(episode, rig) for episode in stored]
        elif path.suffix.lower() == ".csv":
            motions.append(read_csv(path, rig))
        else:
            raise DatasetError(f"{path}: is no recording; give {_VALID}")
    if not motions:
        raise UsageError(f"no recording holds a motion; give {_VALID}")
    return motions
