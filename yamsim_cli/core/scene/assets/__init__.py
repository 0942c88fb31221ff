"""Meshes that yamsim does not ship: their lock, their store and their sources.

Only `fetch` and `fetch_missing` use the network. `load_lock` and `AssetStore.resolve` only read files.
"""

from .asset_lock import AssetLock, AssetSet, LockedFile, Reduction, load_lock
from .asset_store import AssetStore, FileStatus, is_user_set, publish_user_set, resolve_user_set
from .fetch import FetchReport, default_sources, fetch, fetch_missing
from .mesh_reduction import ReducedSet, find_reduced, make_reduced
from .sources import FetchProgress, SourceError

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
    "is_user_set",
    "load_lock",
    "make_reduced",
    "publish_user_set",
    "resolve_user_set",
]
