"""What a source of meshes is."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from .lock import AssetSet


class SourceError(Exception):
    """Why one source could not give a set, in a few words; `fetch` collects these and tries the next source."""


class Progress(Protocol):
    """Told how far a download is, in bytes and in the thread that called `fetch`; the total is the lock's."""

    def __call__(self, label: str, done_bytes: int, total_bytes: int) -> None:
        """Take note; must return quickly."""


def no_progress(label: str, done_bytes: int, total_bytes: int) -> None:
    """Ignore progress."""


class AssetSource(Protocol):
    """One place meshes can come from. What it returns is not trusted: the store verifies every byte."""

    @property
    def name(self) -> str:
        """How reports and errors call it."""

    def offers(self, assets: AssetSet) -> bool:
        """Whether asking for this set makes sense; no I/O."""

    def read(self, assets: AssetSet, scratch: Path, progress: Progress) -> dict[str, bytes]:
        """Get the set's files.

        Args:
            assets: the set to get.
            scratch: an empty folder of its own, deleted afterwards.
            progress: told of the bytes as they arrive.

        Returns:
            File name -> content.

        Raises:
            SourceError: it cannot give the set.
        """
