from __future__ import annotations

from pathlib import Path
from typing import Protocol

from .asset_lock import AssetSet


class SourceError(Exception):
    """A source cannot provide a set. `mesh_download.fetch` collects the reasons and tries the next source."""


class FetchProgress(Protocol):
    """Progress of a download, bytes; called in the thread that fetches."""

    def __call__(self, label: str, done_bytes: int, total_bytes: int, /) -> None:
        """Must return quickly."""


def no_progress(label: str, done_bytes: int, total_bytes: int) -> None:
    """Show no progress."""


class AssetSource(Protocol):
    """A source that downloads or generates meshes. Sources are untrusted: the store verifies every byte."""

    @property
    def name(self) -> str:
        """The source's name in reports and errors."""

    def has_set(self, assets: AssetSet) -> bool:
        """Return whether to try this source for the set, decided without I/O."""

    def read(self, assets: AssetSet, scratch: Path, progress: FetchProgress) -> dict[str, bytes]:
        """Return file name -> content for the set's files, or raise SourceError.

        `scratch` is empty, and deleted afterwards. Its parent exists until all sets are read.
        """
