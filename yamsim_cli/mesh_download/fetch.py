"""Fetch missing asset sets into the store, each from the first source that provides the locked files."""

from __future__ import annotations

import contextlib
import shutil
import uuid
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..core.errors import ResourceError
from ..core.files.writing import exclusive_lock
from ..core.scene.assets.asset_lock import AssetLock, AssetSet
from ..core.scene.assets.asset_store import AssetStore, MismatchError
from ..core.scene.assets.sources import AssetSource, FetchProgress, SourceError, no_progress
from .downloads import GeneratedMeshes, MenagerieMeshes, PinnedArchives

ALREADY_STORED = "store"  # `FetchedSet.source` of a set that was already present


@dataclass(frozen=True)
class FetchedSet:
    """A set in the store; `source` is `"store"` if it was already present."""

    name: str
    source: str
    directory: Path


@dataclass(frozen=True)
class FetchReport:
    """Result of `fetch`: all requested sets, in the lock's order."""

    sets: tuple[FetchedSet, ...]


def default_sources(lock: AssetLock) -> tuple[AssetSource, ...]:
    """Return the sources of meshes in the order of trial."""
    return GeneratedMeshes(lock.generated_sets), MenagerieMeshes(), PinnedArchives(lock.archives)


def fetch(
    lock: AssetLock,
    names: Iterable[str],
    store: AssetStore,
    sources: Sequence[AssetSource],
    progress: FetchProgress = no_progress,
    *,
    stop_at_failure: bool = False,
) -> FetchReport:
    """Fetch the named sets that are not in the store. Each set is published in one step.

    If two processes fetch at the same time, one waits.

    Args:
        names: names of sets in `lock`; if empty, all sets that are not on demand.
        stop_at_failure: whether to skip the remaining sets after one that no source provides.
    """
    wanted = lock.select_sets(names)
    found = {assets.name: store.find_verified_folder(assets) for assets in wanted}
    sets = {
        name: FetchedSet(name, ALREADY_STORED, directory) for name, directory in found.items() if directory is not None
    }
    missing = [assets for assets in wanted if assets.name not in sets]
    failures = []
    if missing:
        with store.write_lock() as staging:
            for assets in missing:
                try:
                    sets[assets.name] = _publish_set(assets, lock, store, sources, staging, progress)
                except SourceError as error:
                    failures.append(f"{assets.name} ({error})")
                    if stop_at_failure:
                        break
            if not failures:
                store.fetch_failure_file.unlink(missing_ok=True)
    if failures:
        raise ResourceError(
            f"could not fetch {', '.join(failures)}; check the network and run `yamsim assets fetch` again, or copy "
            f"the files by hand into {store.root}/<set>/ (`yamsim assets list` names them)"
        )
    return FetchReport(tuple(sets[assets.name] for assets in wanted))


def _publish_set(
    assets: AssetSet,
    lock: AssetLock,
    store: AssetStore,
    sources: Sequence[AssetSource],
    staging: Path,
    progress: FetchProgress,
) -> FetchedSet:
    """Publish a set from the first source that provides the locked files. Needs `store.write_lock`."""
    if (present := store.find_verified_folder(assets)) is not None:
        # Another process fetched the set while this one waited for the store.
        return FetchedSet(assets.name, ALREADY_STORED, present)
    reasons = []
    for source in sources:
        if not source.has_set(assets):
            continue
        try:
            files = _read_source(source, assets, staging / uuid.uuid4().hex, progress)
            directory = store.publish(assets, files, lock.notices[assets.notice])
        except (SourceError, MismatchError) as error:
            reasons.append(f"{source.name}: {error}")
        else:
            return FetchedSet(assets.name, source.name, directory)
    raise SourceError("; ".join(reasons) or "no source offers it")


def _read_source(source: AssetSource, assets: AssetSet, scratch: Path, progress: FetchProgress) -> dict[str, bytes]:
    try:
        scratch.mkdir()
        return source.read(assets, scratch, progress)
    except OSError as error:
        raise SourceError(str(error)) from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


FAILURE_VALID_S = 3600.0  # s after a failed download, in which commands do not try again
MAX_IDLE_S = 7.0  # s without progress; with Menagerie's probe of 2 s, a fetch without network ends in 10 s
MAX_ARCHIVE_S = 300.0  # s, for an archive of at most 33 MB, which requires 110 kB/s
MAX_MENAGERIE_S = 30.0  # s, for a model of 5 MB; then the pinned archive is tried

_LOCK = ".first-use"


def fetch_missing(lock: AssetLock, names: Collection[str], store: AssetStore, progress: FetchProgress) -> None:
    """Fetch missing sets before a command renders them, and stop at the first failure.

    After a failure, no network source is tried again for `FAILURE_VALID_S`.
    """
    try:
        store.root.mkdir(parents=True, exist_ok=True)
        with exclusive_lock(store.root / _LOCK):
            if made := [name for name in names if name in lock.generated_sets]:
                fetch(lock, made, store, (GeneratedMeshes(lock.generated_sets),))
            if downloaded := [name for name in names if name not in lock.generated_sets]:
                _download_absent_sets(lock, downloaded, store, progress)
    except OSError as error:
        raise ResourceError(f"cannot write to the asset store {store.root}: {error.strerror or error}") from error


def _download_absent_sets(lock: AssetLock, names: Collection[str], store: AssetStore, progress: FetchProgress) -> None:
    absent = [name for name in names if store.find_verified_folder(lock.sets[name]) is None]
    if not absent:
        return
    if _has_failed_recently(store):
        raise ResourceError("fetching them failed less than an hour ago; run `yamsim assets fetch` to try again now")
    sources = (
        MenagerieMeshes(limit_s=MAX_MENAGERIE_S),
        PinnedArchives(lock.archives, idle_s=MAX_IDLE_S, limit_s=MAX_ARCHIVE_S),
    )
    try:
        fetch(lock, absent, store, sources, progress, stop_at_failure=True)
    except ResourceError:
        with contextlib.suppress(OSError):
            store.fetch_failure_file.touch()
        raise


def _has_failed_recently(store: AssetStore) -> bool:
    lock = store.root / _LOCK
    try:
        # Both times are by the file system's clock, which can differ from the machine's.
        lock.touch()
        age_s = lock.stat().st_mtime - store.fetch_failure_file.stat().st_mtime
    except OSError:
        return False
    return 0 <= age_s < FAILURE_VALID_S
