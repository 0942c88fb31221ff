"""The protocol of the sources of asset sets."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from .asset_lock import AssetSet


class SourceError(Exception):
    """A source cannot give a set; `fetch` collects the reasons and tries the next source."""


class FetchProgress(Protocol):
    """Called with the progress of a download in bytes, from the thread that called `fetch`."""

    def __call__(self, label: str, done_bytes: int, total_bytes: int, /) -> None:
        """Show the progress; must return quickly."""


def no_progress(label: str, done_bytes: int, total_bytes: int) -> None:
    """Ignore progress."""


class AssetSource(Protocol):
    """An untrusted source of meshes: the store verifies every byte."""

    @property
    def name(self) -> str:
        """The source's name in reports and errors."""

    def has_set(self, assets: AssetSet) -> bool:
        """Whether the source may have the set; without I/O."""

    def read(self, assets: AssetSet, scratch: Path, progress: FetchProgress) -> dict[str, bytes]:
        """File name -> content of the set's files.

        Args:
            scratch: an empty folder, deleted afterwards. Its parent exists until all sets of the fetch are read.

        Raises SourceError if the source cannot give the set.
        """
