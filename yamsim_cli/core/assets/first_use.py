"""Fetches the sets that a command shows and the store lacks, and gives up within seconds without a network."""

from __future__ import annotations

import contextlib
from collections.abc import Collection

from ..errors import ResourceError
from ..files import exclusive_lock
from .archives import PinnedArchives
from .fetch import fetch
from .lock import AssetLock
from .made import MadeHere
from .menagerie import Menagerie
from .sources import FetchProgress
from .store import AssetStore

REMEMBERED_S = 3600.0  # s, how long a failed attempt keeps later commands from waiting for another one
IDLE_S = 7.0  # s, longest time without a byte; with Menagerie's probe of 2 s, an attempt without a network ends in 10 s
ARCHIVE_S = 300.0  # s, longest time for one archive of 33 MB at most: 110 kB/s is enough
MENAGERIE_S = 30.0  # s, longest time for the 5 MB of Menagerie's model; the pinned archive is tried after it

_LOCK = ".first-use"


def fetch_missing(lock: AssetLock, names: Collection[str], store: AssetStore, progress: FetchProgress) -> None:
    """Fetch sets into the store, and stop at the first one that cannot be had.

    A failure is noted in the store. Within `REMEMBERED_S` of it no source on the network is asked again. Two processes
    may call this at once: the second one waits, and tries nothing that has just failed.

    Raises:
        ResourceError: a set could not be had, now or a short time ago.
    """
    try:
        store.root.mkdir(parents=True, exist_ok=True)
        with exclusive_lock(store.root / _LOCK):
            if made := [name for name in names if name in lock.made]:
                fetch(lock, made, store, (MadeHere(lock.made),))
            if downloaded := [name for name in names if name not in lock.made]:
                _download(lock, downloaded, store, progress)
    except OSError as error:
        raise ResourceError(f"cannot write to the asset store {store.root}: {error.strerror or error}") from error


def _download(lock: AssetLock, names: Collection[str], store: AssetStore, progress: FetchProgress) -> None:
    absent = [name for name in names if store.resolve(lock.sets[name]) is None]
    if not absent:
        return
    if _failed_lately(store):
        raise ResourceError("fetching them failed less than an hour ago; run `yamsim assets fetch` to try again now")
    sources = (Menagerie(limit_s=MENAGERIE_S), PinnedArchives(lock.archives, idle_s=IDLE_S, limit_s=ARCHIVE_S))
    try:
        fetch(lock, absent, store, sources, progress, stop_at_failure=True)
    except ResourceError:
        with contextlib.suppress(OSError):
            store.failure_mark.touch()
        raise


def _failed_lately(store: AssetStore) -> bool:
    lock = store.root / _LOCK
    try:
        # Both times are of one file system's clock, which may not be the clock of this machine.
        lock.touch()
        age_s = lock.stat().st_mtime - store.failure_mark.stat().st_mtime
    except OSError:
        return False
    return 0 <= age_s < REMEMBERED_S
