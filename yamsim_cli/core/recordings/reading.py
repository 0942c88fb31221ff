"""Motions from whatever holds them: episodes and datasets of ours, and the recordings of others."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..config.rig import RigConfig
from ..dataset.layout import EPISODE
from ..dataset.reader import open_recorded, recorded_episodes
from ..dataset.real import is_ours
from ..errors import UsageError
from ..motion import Motion
from ..resources import Locations
from .episodes import read_episode
from .formats import format_of, reader_of


def read_motions(
    recordings: Sequence[Path], rig: RigConfig, locations: Locations, mapping: str | None = None
) -> list[Motion]:
    """The motions of recordings, in order, with all samples that there are; those of a dataset are all its episodes'.

    Args:
        mapping: how somebody else's columns are called, see `naming.naming_of`.

    Raises:
        DatasetError: one is not there, cannot be read, is damaged or of another rig.
        UsageError: there is none.
    """
    motions: list[Motion] = []
    for path in recordings:
        if is_ours(path):
            stored = [open_recorded(path)] if (path / EPISODE).exists() else recorded_episodes(path)
            motions += [read_episode(episode, rig) for episode in stored]
        else:
            read = reader_of(format_of(path))
            motions += [recording.in_metres(rig) for recording in read(path, rig, mapping, locations)]
    if not motions:
        raise UsageError("no recording holds a motion; give a .csv, an episode's directory, or a dataset's")
    return motions
