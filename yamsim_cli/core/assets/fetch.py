"""Brings missing sets into the store: each source is asked in turn, and what it gives is verified and published."""

from __future__ import annotations

import shutil
import uuid
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import ResourceError
from .archives import PinnedArchives
from .lock import AssetLock, AssetSet
from .made import MadeHere
from .menagerie import Menagerie
from .sources import AssetSource, FetchProgress, SourceError, no_progress
from .store import AssetStore, MismatchError

# A report's source of a set that was already there.
STORE = "store"


@dataclass(frozen=True)
class FetchedSet:
    """A set that is now in the store: its name, the source it came from (`"store"` if it was there), and its folder."""

    name: str
    source: str
    directory: Path


@dataclass(frozen=True)
class FetchReport:
    """Every set that was asked for, in the lock's order."""

    sets: tuple[FetchedSet, ...]


def default_sources(lock: AssetLock) -> tuple[AssetSource, ...]:
    """The sources beyond the store itself, the most official first."""
    return MadeHere(lock.made), Menagerie(), PinnedArchives(lock.archives)


def fetch(
    lock: AssetLock,
    names: Iterable[str],
    store: AssetStore,
    sources: Sequence[AssetSource],
    progress: FetchProgress = no_progress,
    *,
    stop_at_failure: bool = False,
) -> FetchReport:
    """Where each of the named sets is in the store, after those that are missing were fetched.

    Without names, these are all sets that are not on demand.

    Sets that are there and verify are left alone, and take no network. Two processes may fetch at once: one does the
    work, the other waits and finds it done. A set is published whole or not at all.

    Args:
        lock: the sets that there are.
        names: names of sets in `lock`; all of them if empty.
        store: where the sets go.
        sources: asked in this order, for each set, until one gives it.
        progress: told of bytes as they arrive.
        stop_at_failure: do not try further sets after one that no source gave.

    Raises:
        UsageError: a name is not in the lock.
        ResourceError: the store cannot be written to, or no source could give a set; the others are published.
    """
    wanted = lock.select(names)
    found = {assets.name: store.resolve(assets) for assets in wanted}
    sets = {name: FetchedSet(name, STORE, directory) for name, directory in found.items() if directory is not None}
    missing = [assets for assets in wanted if assets.name not in sets]
    failures = []
    if missing:
        try:
            with store.writing() as staging:
                for assets in missing:
                    try:
                        sets[assets.name] = _obtain(assets, lock, store, sources, staging, progress)
                    except SourceError as error:
                        failures.append(f"{assets.name} ({error})")
                        if stop_at_failure:
                            break
                if not failures:
                    store.failure_mark.unlink(missing_ok=True)
        except OSError as error:
            raise ResourceError(
                f"cannot write to the asset store {store.root}: {error.strerror or error}; free some space, or set "
                "YAMSIM_ASSETS to a folder that can be written to"
            ) from error
    if failures:
        raise ResourceError(
            f"could not fetch {', '.join(failures)}; check the network and run `yamsim assets fetch` again, or copy "
            f"the files by hand into {store.root}/<set>/ (`yamsim assets list` names them)"
        )
    return FetchReport(tuple(sets[assets.name] for assets in wanted))


def _obtain(
    assets: AssetSet,
    lock: AssetLock,
    store: AssetStore,
    sources: Sequence[AssetSource],
    staging: Path,
    progress: FetchProgress,
) -> FetchedSet:
    """One set, published from the first source that gives the locked files; the caller holds the store for writing."""
    if (present := store.resolve(assets)) is not None:
        # Another process fetched it while we waited for the store.
        return FetchedSet(assets.name, STORE, present)
    reasons = []
    for source in sources:
        if not source.offers(assets):
            continue
        try:
            files = _read(source, assets, staging / uuid.uuid4().hex, progress)
            directory = store.publish(assets, files, lock.notices[assets.notice])
        except (SourceError, MismatchError) as error:
            reasons.append(f"{source.name}: {error}")
        else:
            return FetchedSet(assets.name, source.name, directory)
    raise SourceError("; ".join(reasons) or "no source offers it")


def _read(source: AssetSource, assets: AssetSet, scratch: Path, progress: FetchProgress) -> dict[str, bytes]:
    """The files that one source gives. Its scratch folder is removed, and an OSError counts as the source's failure."""
    try:
        scratch.mkdir()
        return source.read(assets, scratch, progress)
    except OSError as error:
        raise SourceError(str(error)) from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
