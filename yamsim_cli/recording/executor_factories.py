"""Factories for the executors of a recording.

Workers of a Ray cluster need no shared filesystem and no local meshes: they receive robot models and meshes as bytes.
"""

from __future__ import annotations

import contextlib
import functools
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from ..core.config.recording import RecordConfig
from ..core.config.session import Session
from ..core.episode.runner import AttemptRunner
from ..core.files.resources import Locations
from ..core.workers.executors import InlineExecutor
from ..core.workers.process_pool import ProcessPool
from ..core.workers.worker_pool import JOB_TIMEOUT
from ..early_worker import EarlyWorker
from .collect import EpisodeExecutor
from .ray_pool import RayPool

_MODELS = "robot_models"


# Starts the workers that simulate and render the attempts of a recording; gets the session and the number of workers.
ExecutorFactory = Callable[[Session, int], EpisodeExecutor]


def process_executor(
    session: Session, workers: int, job_seconds: float = JOB_TIMEOUT, early: EarlyWorker | None = None
) -> EpisodeExecutor:
    """Return an executor in processes of this machine, for `job_seconds` (s) an attempt; `early` is the first."""
    runner = functools.partial(AttemptRunner, session, render=True)
    return ProcessPool(runner, workers, job_seconds, early.start if early else None)


def ray_executor(
    session: Session,
    workers: int,
    address: str | None = None,
    environ: Mapping[str, str] | None = None,
    job_seconds: float = JOB_TIMEOUT,
) -> EpisodeExecutor:
    """Return an executor in actors of a Ray cluster, for `job_seconds` (s) an attempt.

    Without `address`, a cluster starts on this machine.
    """
    factory = functools.partial(unpacked_runner, pack_session(session))
    return RayPool(factory, workers, address=address, environ=environ, job_seconds=job_seconds)


def inline_executor(session: Session, workers: int) -> EpisodeExecutor:
    """Return an executor in this process, regardless of the number of workers."""
    return InlineExecutor(lambda: AttemptRunner(session, render=True))


@dataclass(frozen=True)
class PackedSession:
    """A session with the content of its robot models and meshes, to send to another machine.

    Attributes:
        files: path relative to the target directory of `unpack_session` -> content.
        meshes: asset set -> its folder relative to that directory, or None for primitives.
    """

    config: RecordConfig
    files: Mapping[str, bytes]
    meshes: Mapping[str, str | None]


def pack_session(session: Session) -> PackedSession:
    """Pack a session with the content of its robot models and meshes."""
    locations = session.locations
    files: dict[str, bytes] = {}
    # Files of the data folder with the highest priority replace others.
    for root in reversed(locations.data):
        files |= _read_folder(root / _MODELS, _MODELS)
    for name, folder in locations.meshes.items():
        if folder is not None:
            files |= _read_folder(folder, f"meshes/{name}")
    meshes = {name: f"meshes/{name}" if folder else None for name, folder in locations.meshes.items()}
    return PackedSession(session.config, files, meshes)


def unpack_session(packed: PackedSession, place: Path) -> Session:
    """Write the files below `place`, and return the session with their locations."""
    for name, data in packed.files.items():
        file = place / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)
    meshes = {name: place / folder if folder is not None else None for name, folder in packed.meshes.items()}
    return Session(packed.config, Locations(data=(place,), assets=place / "meshes", meshes=meshes))


@contextlib.contextmanager
def unpacked_runner(packed: PackedSession) -> Iterator[AttemptRunner]:
    """Yield an `AttemptRunner`, and remove the unpacked files at the end."""
    # Keep the files while the runner is in use: scenes are composed from them when first needed.
    with (
        tempfile.TemporaryDirectory(prefix="yamsim-") as place,
        AttemptRunner(unpack_session(packed, Path(place)), render=True) as runner,
    ):
        yield runner


def _read_folder(folder: Path, prefix: str) -> dict[str, bytes]:
    return {
        f"{prefix}/{path.relative_to(folder).as_posix()}": path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
