"""Meshes that yamsim does not ship: their lock, their store and their sources.

The package `mesh_download` downloads them. This package only reads files.
"""

from .asset_lock import AssetLock, AssetSet, LockedFile, Reduction, load_lock
from .asset_store import AssetStore, FileStatus, is_user_set, publish_user_set, resolve_user_set
from .mesh_reduction import ReducedSet, find_reduced, make_reduced
from .sources import FetchProgress, SourceError

__all__ = [
    "AssetLock",
    "AssetSet",
    "AssetStore",
    "FetchProgress",
    "FileStatus",
    "LockedFile",
    "ReducedSet",
    "Reduction",
    "SourceError",
    "find_reduced",
    "is_user_set",
    "load_lock",
    "make_reduced",
    "publish_user_set",
    "resolve_user_set",
]
