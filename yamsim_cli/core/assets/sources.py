"""The protocol of a source of meshes, and its errors and progress."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from .lock import AssetSet


class SourceError(Exception):
    """Why one source could not give a set, in a few words; `fetch` collects these and tries the next source."""


class FetchProgress(Protocol):
    """Called with how far a download is, in bytes, from the thread that called `fetch`; the lock gives the total."""

    def __call__(self, label: str, done_bytes: int, total_bytes: int, /) -> None:
        """Take note; must return quickly."""


def no_progress(label: str, done_bytes: int, total_bytes: int) -> None:
    """Ignore progress."""


class AssetSource(Protocol):
    """A place that meshes can come from. It is not trusted: the store verifies every byte."""

    @property
    def name(self) -> str:
        """The source's name in reports and errors."""

    def offers(self, assets: AssetSet) -> bool:
        """Whether the source may have this set; without I/O."""

    def read(self, assets: AssetSet, scratch: Path, progress: FetchProgress) -> dict[str, bytes]:
        """The set's files.

        Args:
            assets: the set to get.
            scratch: an empty folder for this set, deleted afterwards. Its parent is kept until all sets of the fetch
                are read.
            progress: told of the bytes as they arrive.

        Returns:
            File name -> content.

        Raises:
            SourceError: it cannot give the set.
        """
