"""Reduced meshes, kept beside the sets they are made from: a folder with the same file names and fewer faces."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import ResourceError
from ..files import publish_directory, sha256_bytes, sha256_file
from .lock import AssetSet
from .reduction import recipe, reduce_stl
from .store import AssetStore

REPORT = "reduction.json"

# Called with the number of files done, and of all files.
FilesDone = Callable[[int, int], None]


@dataclass(frozen=True)
class ReducedSet:
    """A set's reduced meshes: their folder, and how many faces the source and the reduced meshes have."""

    directory: Path
    source_faces: int
    faces: int


def find_reduced(store: AssetStore, assets: AssetSet) -> ReducedSet | None:
    """The set's reduced meshes, each verified by SHA-256; None if they are not there or were made by another recipe.

    Raises:
        ResourceError: a library that they are made with is not installed.
    """
    folder = store.root / _folder_name(assets)
    try:
        files = json.loads((folder / REPORT).read_bytes())["files"]
        right = set(files) == set(assets.files) and all(
            sha256_file(folder / name) == entry["sha256"] for name, entry in files.items()
        )
        return _reduced_set(folder, files) if right else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def make_reduced(
    store: AssetStore, assets: AssetSet, source: Path, notice: str, progress: FilesDone = lambda done, total: None
) -> ReducedSet:
    """The set's reduced meshes, which are made and published in one step if they are not there.

    Two processes may call this at once: one does the work, the other waits and finds it done.

    Args:
        source: the folder with the set's own files, as `AssetStore.resolve` gives it.
        notice: the licence text to keep beside them.

    Raises:
        ResourceError: a library for it is not installed, a mesh cannot be read, or the store cannot be written to.
    """
    if (there := find_reduced(store, assets)) is not None:
        return there
    try:
        with store.writing() as staging:
            if (there := find_reduced(store, assets)) is not None:
                return there
            files, report = _reduce_all(assets, source, progress)
            final = store.root / _folder_name(assets)
            if final.exists():
                # Only reached when the folder failed verification.
                final.rename(staging / "damaged")
            text = json.dumps({"source": assets.directory_name, "recipe": recipe(), "files": report}, indent=1) + "\n"
            publish_directory(final, files | {assets.notice: notice.encode(), REPORT: text.encode()}, staging)
            return _reduced_set(final, report)
    except OSError as error:
        raise ResourceError(f"cannot write to the asset store {store.root}: {error.strerror or error}") from error
    except ImportError as error:
        raise ResourceError(_missing(error)) from error


def _reduce_all(
    assets: AssetSet, source: Path, progress: FilesDone
) -> tuple[dict[str, bytes], dict[str, dict[str, Any]]]:
    """File name -> reduced mesh, and file name -> its entry in the report."""
    files, report = {}, {}
    for number, (name, locked) in enumerate(assets.files.items(), start=1):
        data = (source / name).read_bytes()
        try:
            files[name] = reduce_stl(data, locked.reduction)
        except ResourceError as error:
            raise ResourceError(f"{name}: {error}") from error
        report[name] = {
            "sha256": sha256_bytes(files[name]),
            "source_faces": _faces(data),
            "faces": _faces(files[name]),
        }
        progress(number, len(assets.files))
    return files, report


def _faces(stl: bytes) -> int:
    return int.from_bytes(stl[80:84], "little")


def _reduced_set(folder: Path, files: dict[str, dict[str, Any]]) -> ReducedSet:
    source_faces, faces = (sum(int(entry[key]) for entry in files.values()) for key in ("source_faces", "faces"))
    return ReducedSet(folder, source_faces, faces)


def _folder_name(assets: AssetSet) -> str:
    """The folder's name. It changes with the source's content, and with all that decides the reduced files' bytes."""
    try:
        how = [recipe()] + [f"{name} {locked.reduction}" for name, locked in sorted(assets.files.items())]
    except ImportError as error:
        raise ResourceError(_missing(error)) from error
    return f"{assets.directory_name}-reduced-{sha256_bytes(chr(10).join(how).encode())[:12]}"


def _missing(error: ImportError) -> str:
    return f"meshes are reduced by packages that are not all installed ({error}); install yamsim's requirements"
