"""Reduced meshes with fewer faces for rendering, stored beside their source sets.

Quadric collapse stalls on the slivers of CAD meshes, so the slivers are removed first. A result that deviates too much
from its source is not used.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import ResourceError
from ...files.writing import sha256_bytes, sha256_file
from ...geometry.se3 import Array
from ...geometry.stl import Faces, decode_stl, encode_stl
from ...geometry.surface_distance import hausdorff_distance
from .asset_lock import AssetSet, Reduction
from .asset_store import AssetStore

MAX_DEVIATION_MM = 0.5  # Hausdorff distance between a reduced mesh and its source
_DEFAULT_SLIVERS_MM = 0.2  # of sliver removal for a mesh without a `Reduction` in the lock
_AGGRESSIVENESS = 6.0  # of the collapse, 0 to 10; below 5 the collapse stalls on CAD meshes, above 7 it tears them
_SAMPLES = 1000  # on each surface for the distance; the tests use twenty times as many
_MM = 1000.0  # mm per metre; the STL files are in metres

REPORT_FILE = "reduction.json"  # beside reduced meshes, with their hashes and numbers of faces

Surface = tuple[Array, Faces]


def reduction_fingerprint() -> str:
    """Return all constants and library versions on which a reduction depends, as text."""
    libraries = " ".join(f"{name} {version(name)}" for name in ("manifold3d", "fast-simplification"))
    return f"1 {_DEFAULT_SLIVERS_MM} {_AGGRESSIVENESS} {MAX_DEVIATION_MM} {_SAMPLES} {libraries}"


def reduce_stl(data: bytes, reduction: Reduction | None) -> bytes:
    """Return a binary STL (m) with fewer faces that deviates from `data` by at most `MAX_DEVIATION_MM`, else `data`."""
    vertices, triangles = decode_stl(data)
    source = vertices * _MM, triangles
    attempts = [collapse_edges(source, reduction)] if reduction else []
    for attempt in (*attempts, remove_slivers(source, _DEFAULT_SLIVERS_MM)):
        if (
            len(attempt[1]) < len(triangles)
            and hausdorff_distance(source, attempt, MAX_DEVIATION_MM, _SAMPLES) <= MAX_DEVIATION_MM
        ):
            return encode_stl(attempt[0] / _MM, attempt[1])
    return data


def collapse_edges(source: Surface, reduction: Reduction) -> Surface:
    """Return a surface (mm) without slivers, collapsed to about `reduction.faces` triangles."""
    import fast_simplification

    vertices, triangles = remove_slivers(source, reduction.slivers_mm)
    if len(triangles) <= reduction.faces:
        return vertices, triangles
    vertices, triangles = fast_simplification.simplify(
        vertices, triangles, target_count=reduction.faces, agg=_AGGRESSIVENESS
    )
    return vertices, _without_zero_area(vertices, triangles.astype(np.int32))


def _without_zero_area(vertices: Array, triangles: Faces) -> Faces:
    """Omit triangles whose area is zero at the precision of an STL file (float32)."""
    a, b, c = np.moveaxis(vertices.astype(np.float32).astype(np.float64)[triangles], 1, 0)
    return triangles[np.cross(b - a, c - a).any(axis=1)]


def remove_slivers(source: Surface, tolerance: float) -> Surface:
    """Return a surface (mm) without slivers, moved by at most about `tolerance` mm; unchanged if not a manifold."""
    import manifold3d

    if not tolerance:
        return source
    vertices, triangles = source
    body = manifold3d.Manifold(manifold3d.Mesh(vertices.astype(np.float32), triangles.astype(np.uint32)))
    if body.status() is not manifold3d.Error.NoError:
        return source
    simple = body.simplify(tolerance).to_mesh()
    return np.array(simple.vert_properties[:, :3], np.float64), np.array(simple.tri_verts, np.int32)


# Is called with the numbers of finished files and of all files.
FileProgress = Callable[[int, int], None]


@dataclass(frozen=True)
class ReducedSet:
    """The reduced meshes of a set, with their numbers of faces before and after."""

    directory: Path
    source_faces: int
    faces: int


def find_reduced(store: AssetStore, assets: AssetSet) -> ReducedSet | None:
    """Return a set's reduced meshes, verified by SHA-256; None if missing, changed or made with other parameters."""
    folder = store.root / _folder_name(assets)
    try:
        files = json.loads((folder / REPORT_FILE).read_bytes())["files"]
        valid = set(files) == set(assets.files) and all(
            sha256_file(folder / name) == entry["sha256"] for name, entry in files.items()
        )
        return _reduced_set(folder, files) if valid else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def make_reduced(
    store: AssetStore, assets: AssetSet, source: Path, notice: str, progress: FileProgress = lambda done, total: None
) -> ReducedSet:
    """Return a set's reduced meshes. If they are missing, create and publish them with a license `notice`.

    If two processes call this function at the same time, one creates the meshes and the other waits. `source` is the
    folder of the unreduced files, from `AssetStore.find_verified_folder`.
    """
    if (there := find_reduced(store, assets)) is not None:
        return there
    try:
        with store.write_lock():
            if (there := find_reduced(store, assets)) is not None:
                return there
            files, report = _reduce_all(assets, source, progress)
            text = (
                json.dumps(
                    {"source": assets.directory_name, "recipe": reduction_fingerprint(), "files": report}, indent=1
                )
                + "\n"
            )
            content = files | {assets.notice: notice.encode(), REPORT_FILE: text.encode()}
            return _reduced_set(store.publish_folder(_folder_name(assets), content), report)
    except ImportError as error:
        raise ResourceError(_missing_message(error)) from error


def _reduce_all(
    assets: AssetSet, source: Path, progress: FileProgress
) -> tuple[dict[str, bytes], dict[str, dict[str, Any]]]:
    files, report = {}, {}
    for number, (name, locked) in enumerate(assets.files.items(), start=1):
        data = (source / name).read_bytes()
        try:
            files[name] = reduce_stl(data, locked.reduction)
        except ResourceError as error:
            raise ResourceError(f"{name}: {error}") from error
        report[name] = {
            "sha256": sha256_bytes(files[name]),
            "source_faces": _face_count(data),
            "faces": _face_count(files[name]),
        }
        progress(number, len(assets.files))
    return files, report


def _face_count(stl: bytes) -> int:
    return int.from_bytes(stl[80:84], "little")


def _reduced_set(folder: Path, files: dict[str, dict[str, Any]]) -> ReducedSet:
    source_faces, faces = (sum(int(entry[key]) for entry in files.values()) for key in ("source_faces", "faces"))
    return ReducedSet(folder, source_faces, faces)


def _folder_name(assets: AssetSet) -> str:
    """The name has a hash of all parameters of the reduction."""
    try:
        how = [reduction_fingerprint()] + [
            f"{name} {locked.reduction}" for name, locked in sorted(assets.files.items())
        ]
    except ImportError as error:
        raise ResourceError(_missing_message(error)) from error
    return f"{assets.directory_name}-reduced-{sha256_bytes(chr(10).join(how).encode())[:12]}"


def _missing_message(error: ImportError) -> str:
    return f"a package that reduces meshes is not installed ({error}); install yamsim's requirements"
