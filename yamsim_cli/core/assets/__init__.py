"""Meshes that yamsim does not ship: which files they are, where they are kept, and how they are fetched.

Reading needs `load_lock` and `AssetStore.resolve` and never touches the network; only `fetch` and `fetch_missing` do.
"""

from .fetch import FetchedSet, FetchReport, default_sources, fetch
from .first_use import fetch_missing
from .lock import Archive, AssetLock, AssetSet, LockedFile, Reduction
from .made import load_lock
from .own_sets import about_own, is_own, publish_own, resolve_own
from .reduced import ReducedSet, find_reduced, make_reduced
from .sources import AssetSource, FetchProgress, SourceError
from .store import AssetStore, FileState, FileStatus

__all__ = [
    "Archive",
    "AssetLock",
    "AssetSet",
    "AssetSource",
    "AssetStore",
    "FetchProgress",
    "FetchReport",
    "FetchedSet",
    "FileState",
    "FileStatus",
    "LockedFile",
    "ReducedSet",
    "Reduction",
    "SourceError",
    "about_own",
    "default_sources",
    "fetch",
    "fetch_missing",
    "find_reduced",
    "is_own",
    "load_lock",
    "make_reduced",
    "publish_own",
    "resolve_own",
]
