"""Meshes that yamsim does not ship: which files they are, where they are kept, and how they are fetched.

Reading needs `load_lock` and `AssetStore.resolve` and never touches the network; only `fetch` does.
"""

from .fetch import FetchedSet, FetchReport, default_sources, fetch
from .lock import Archive, AssetLock, AssetSet, LockedFile, Reduction, load_lock
from .reduced import ReducedSet, find_reduced, make_reduced
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
    "ReducedSet",
    "Reduction",
    "SourceError",
    "default_sources",
    "fetch",
    "find_reduced",
    "load_lock",
    "make_reduced",
]
