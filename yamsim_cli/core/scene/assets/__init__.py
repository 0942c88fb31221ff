"""Meshes that yamsim does not ship: their lock, their store, and their sources.

Only `fetch` and `fetch_missing` use the network; `load_lock` and `AssetStore.resolve` read files.
"""

from .fetch import FetchReport, default_sources, fetch, fetch_missing
from .lock import AssetLock, AssetSet, LockedFile, Reduction, load_lock
from .reduction import ReducedSet, find_reduced, make_reduced
from .sources import FetchProgress, SourceError
from .store import AssetStore, FileStatus, is_own, publish_own, resolve_own

__all__ = [
    "AssetLock",
    "AssetSet",
    "AssetStore",
    "FetchProgress",
    "FetchReport",
    "FileStatus",
    "LockedFile",
    "ReducedSet",
    "Reduction",
    "SourceError",
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
