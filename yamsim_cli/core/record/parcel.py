"""A session with its files as bytes: so that a worker on another machine needs no shared filesystem and no meshes."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from ..attempt.runner import EpisodeRunner
from ..config.recording import RecordConfig
from ..resources import Locations
from ..session import Session

_MODELS = "robot_models"


@dataclass(frozen=True)
class Parcel:
    """A config, robot models and meshes.

    Attributes:
        config: what is run.
        files: path below the place of unpacking -> content.
        meshes: asset set -> its folder below that place, or None for primitives.
    """

    config: RecordConfig
    files: Mapping[str, bytes]
    meshes: Mapping[str, str | None]


def pack(session: Session) -> Parcel:
    """Read everything that composing a session's scene may read."""
    locations = session.locations
    files: dict[str, bytes] = {}
    # The most important root last, so that its files win.
    for root in reversed(locations.data):
        files |= _read(root / _MODELS, _MODELS)
    for name, folder in locations.meshes.items():
        if folder is not None:
            files |= _read(folder, f"meshes/{name}")
    meshes = {name: f"meshes/{name}" if folder else None for name, folder in locations.meshes.items()}
    return Parcel(session.config, files, meshes)


def unpack(parcel: Parcel, place: Path) -> Session:
    """Write the files below `place`; the session says where they are now."""
    for name, data in parcel.files.items():
        file = place / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)
    meshes = {name: place / folder if folder is not None else None for name, folder in parcel.meshes.items()}
    return Session(parcel.config, Locations(data=(place,), assets=place / "meshes", meshes=meshes))


@contextlib.contextmanager
def unpacked_runner(parcel: Parcel) -> Iterator[EpisodeRunner]:
    """An `EpisodeRunner` from a parcel, whose files are removed at the end."""
    with contextlib.ExitStack() as files:
        place = files.enter_context(tempfile.TemporaryDirectory(prefix="yamsim-"))
        # Every cast of things has a scene of its own, made when it is first needed, so the files stay.
        with EpisodeRunner(unpack(parcel, Path(place)), render=True) as runner:
            yield runner


def _read(folder: Path, prefix: str) -> dict[str, bytes]:
    return {
        f"{prefix}/{path.relative_to(folder).as_posix()}": path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
