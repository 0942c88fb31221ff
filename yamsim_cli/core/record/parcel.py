"""The files a worker needs, as bytes: so that a worker on another machine needs no shared filesystem and no meshes."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from ..attempt.runner import EpisodeRunner
from ..config.recording import RecordConfig
from ..resources import Locations

_MODELS = "robot_models"


@dataclass(frozen=True)
class Parcel:
    """Robot models and meshes.

    Attributes:
        files: path below the place of unpacking -> content.
        meshes: asset set -> its folder below that place, or None for primitives.
    """

    files: Mapping[str, bytes]
    meshes: Mapping[str, str | None]


def pack(locations: Locations, meshes: Mapping[str, Path | None]) -> Parcel:
    """Read everything that composing a scene may read.

    Args:
        meshes: asset set -> folder of its files, or None for primitives.
    """
    files: dict[str, bytes] = {}
    # The most important root last, so that its files win.
    for root in reversed(locations.data):
        files |= _read(root / _MODELS, _MODELS)
    for name, folder in meshes.items():
        if folder is not None:
            files |= _read(folder, f"meshes/{name}")
    return Parcel(files, {name: f"meshes/{name}" if folder else None for name, folder in meshes.items()})


def unpack(parcel: Parcel, place: Path) -> tuple[Locations, dict[str, Path | None]]:
    """Write the files below `place`, and say where they are now."""
    for name, data in parcel.files.items():
        file = place / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)
    meshes = {name: place / folder if folder is not None else None for name, folder in parcel.meshes.items()}
    return Locations(data=(place,), assets=place / "meshes"), meshes


@contextlib.contextmanager
def unpacked_runner(config: RecordConfig, parcel: Parcel) -> Iterator[EpisodeRunner]:
    """An `EpisodeRunner` from a parcel; its files are gone again once the scene is compiled."""
    with tempfile.TemporaryDirectory(prefix="yamsim-") as place:
        locations, meshes = unpack(parcel, Path(place))
        runner = EpisodeRunner(config, locations, meshes, draw=True)
    with runner:
        yield runner


def _read(folder: Path, prefix: str) -> dict[str, bytes]:
    return {
        f"{prefix}/{path.relative_to(folder).as_posix()}": path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
