"""Meshes that yamsim does not ship: their lock, their store, and their sources.

Only `fetch` and `fetch_missing` use the network; `load_lock` and `AssetStore.resolve` read files.
"""

from .fetch import FetchedSet, FetchReport, default_sources, fetch, fetch_missing
from .lock import Archive, AssetLock, AssetSet, LockedFile, Reduction, load_lock
from .own_sets import about_own, is_own, publish_own, resolve_own
from .reduction import ReducedSet, find_reduced, make_reduced
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
