"""Bring missing sets into the store: ask each source in turn, verify, publish."""

from __future__ import annotations

import shutil
import uuid
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import ResourceError
from .archives import PinnedArchives
from .lock import AssetLock, AssetSet
from .menagerie import Menagerie
from .sources import AssetSource, Progress, SourceError, no_progress
from .store import AssetStore, MismatchError

#: What a report calls a set that was already there.
STORE = "store"


@dataclass(frozen=True)
class FetchedSet:
    """A set that is now in the store: its name, the source it came from (`"store"`: it was there), and its folder."""

    name: str
    source: str
    directory: Path


@dataclass(frozen=True)
class FetchReport:
    """Every set that was asked for, in the lock's order."""

    sets: tuple[FetchedSet, ...]


def default_sources(lock: AssetLock) -> tuple[AssetSource, ...]:
    """The sources beyond the store itself, the most official first."""
    return Menagerie(), PinnedArchives(lock.archives)


def fetch(
    lock: AssetLock,
    names: Iterable[str],
    store: AssetStore,
    sources: Sequence[AssetSource],
    progress: Progress = no_progress,
) -> FetchReport:
    """Make sure the named sets (all of them when no name is given) are in the store.

    Sets that are there and verify are left alone, without the network. Two processes may fetch at once: one does the
    work, the other waits and finds it done. A set is published whole or not at all.

    Args:
        lock: what to fetch.
        names: names of sets in `lock`.
        store: where to.
        sources: asked in this order, for each set, until one gives it.
        progress: told of bytes as they arrive.

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
    progress: Progress,
) -> FetchedSet:
    """Get one set from the first source that has it right; the caller holds the store for writing."""
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


def _read(source: AssetSource, assets: AssetSet, scratch: Path, progress: Progress) -> dict[str, bytes]:
    """Ask one source, in a folder that is gone afterwards; its trouble with files is its failure, not the store's."""
    try:
        scratch.mkdir()
        return source.read(assets, scratch, progress)
    except OSError as error:
        raise SourceError(str(error)) from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
