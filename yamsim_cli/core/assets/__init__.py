"""Meshes that yamsim does not ship: which files they are, where they are kept, and how they are fetched.

Reading needs `load_lock` and `AssetStore.resolve` and never touches the network; only `fetch` does.
"""

from .fetch import FetchedSet, FetchReport, default_sources, fetch
from .lock import Archive, AssetLock, AssetSet, LockedFile, load_lock
from .sources import AssetSource, Progress, SourceError
from .store import AssetStore, FileState, FileStatus

__all__ = [
    "Archive",
    "AssetLock",
    "AssetSet",
    "AssetSource",
    "AssetStore",
    "FetchReport",
    "FetchedSet",
    "FileState",
    "FileStatus",
    "LockedFile",
    "Progress",
    "SourceError",
    "default_sources",
    "fetch",
    "load_lock",
]
