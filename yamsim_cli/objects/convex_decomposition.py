"""Decompose bodies into convex parts by CoACD in a child process, with a cache.

Source: X. Wei, M. Liu, Z. Ling, H. Su, "Approximate Convex Decomposition for 3D Meshes with Collision-Aware Concavity
and Tree Search", SIGGRAPH 2022; the package `coacd`.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import ResourceError
from ..core.files.writing import scratch_directory, sha256_bytes, write_file
from ..core.geometry.closed_surface import is_closed, merge_vertices, uniform_mass_properties
from ..core.geometry.se3 import Array
from ..core.geometry.stl import Faces
from ..core.scene.assets.child_process import python_call_command, run_child
from ..core.scene.assets.sources import SourceError
from .part_surfaces import simplified_mesh

DECOMPOSITION_FOLDER = "decomposed"  # folder of cached results, beside the mesh sets

# Triangle counts of the reduced body, tried in order, and its largest deviation; the parts deviate by 1 to 2 mm.
_FACE_COUNTS, _LIMIT_MM = (1_000, 2_000, 4_000, 8_000), 0.3

# Found by experiment (docs/figures.md). `threshold`: concavity at which cutting stops, as a share of half the body's
# length. `parts`: maximum number of parts. `resolution`: density of surface samples that measure concavity. The others
# limit the tree search for each cut.
_SEARCH_OPTIONS = {"threshold": 0.05, "parts": 32, "iterations": 40, "nodes": 10, "depth": 2, "resolution": 1000}
_TIME_LIMIT_S = 300.0  # s; several times the duration for some thousand triangles
_MEMORY_BYTES = 8_000_000_000  # bytes, address space of the child
_MAX_CPU_SECONDS = 1200  # s, CPU time of the child on all cores

ShareCallback = Callable[[float], None]  # called with the completed share, 0 to 1
TriangleMesh = tuple[Array, Faces]  # vertices (n, 3), m; triangles (m, 3)


def decompose_body(
    body: TriangleMesh, cache: Path, share: ShareCallback = lambda done: None, limit_s: float = _TIME_LIMIT_S
) -> list[TriangleMesh]:
    """Return convex parts whose union approximates a body; `cache` is the folder of earlier results.

    Raises:
        ResourceError: `coacd` is missing, the decomposition fails, or a limit of time or memory is reached.
    """
    if find_spec("coacd") is None:
        raise ResourceError(
            "convex parts need coacd: run `pip install 'yamsim[import]'`, or choose --collision hull or sdf"
        )
    vertices, faces = merge_vertices(*body)
    if (
        is_closed(faces)
        and (fewer := simplified_mesh((vertices, faces), _FACE_COUNTS, _LIMIT_MM, closed=True)) is not None
    ):
        vertices, faces = fewer
    how: dict[str, Any] = {**_SEARCH_OPTIONS, "coacd": version("coacd"), "closed": is_closed(faces)}
    source = io.BytesIO()
    np.savez(source, vertices=vertices, faces=faces)
    text = json.dumps(how, sort_keys=True).encode()
    file = cache / f"{sha256_bytes(vertices.tobytes() + faces.tobytes() + text)}.npz"
    if (parts := _read_bodies(file)) is not None:
        return parts
    with scratch_directory("yamsim-parts-") as scratch:
        (scratch / "body.npz").write_bytes(source.getvalue())
        (scratch / "how.json").write_bytes(text)
        data = _decompose_in_child(scratch, share, limit_s)
    try:
        cache.mkdir(parents=True, exist_ok=True)
        write_file(file, data)
    except OSError as error:
        raise ResourceError(f"{file} cannot be written: {error.strerror}") from error
    parts = _read_bodies(file)
    if parts is None:
        raise ResourceError("the decomposition gave no convex parts: try --collision sdf")
    return parts


def _decompose_in_child(scratch: Path, share: ShareCallback, limit_s: float) -> bytes:
    call = python_call_command(run_decomposition, str(scratch))
    furthest = 0.0

    def report_progress() -> int:
        nonlocal furthest
        log = (scratch / "stdout.txt").read_text(errors="replace")
        # CoACD passes over all parts an unknown number of times.
        rounds = len(re.findall(r"iter \d+", log))
        if re.search(r"Processing \[([\d.]+)%\]", log):
            furthest = max(furthest, rounds / (rounds + 3))
        share(furthest)
        return 0

    try:
        result = run_child(call, scratch, limit_s=limit_s, idle_s=limit_s, watch=report_progress)
    except SourceError as error:
        raise ResourceError(
            f"the decomposition into convex parts is {error}: reduce the mesh first, or choose --collision sdf or hull"
        ) from error
    out = scratch / "parts.npz"
    if result.returncode != 0 or not out.is_file():
        last = (result.stderr.strip().splitlines() or [f"ended with {result.returncode}"])[-1][:200]
        raise ResourceError(f"the mesh cannot be decomposed into convex parts ({last}): choose --collision sdf or hull")
    share(1.0)
    return out.read_bytes()


def run_decomposition(folder: str) -> None:
    """Child process: read `body.npz` in a folder, write its convex parts to `parts.npz`."""
    import resource

    import coacd

    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, _MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (_MAX_CPU_SECONDS, _MAX_CPU_SECONDS))
    scratch = Path(folder)
    how = json.loads((scratch / "how.json").read_bytes())
    with np.load(scratch / "body.npz", allow_pickle=False) as body:
        mesh = coacd.Mesh(body["vertices"], body["faces"])
    coacd.set_log_level("info")
    parts = coacd.run_coacd(
        mesh,
        threshold=how["threshold"],
        max_convex_hull=how["parts"],
        # Remeshing a closed body would give many more faces.
        preprocess_mode="off" if how["closed"] else "on",
        preprocess_resolution=40,
        resolution=how["resolution"],
        mcts_nodes=how["nodes"],
        mcts_iterations=how["iterations"],
        mcts_max_depth=how["depth"],
        decimate=True,
        max_ch_vertex=64,
        seed=1,
    )
    arrays: dict[str, Any] = {}
    for number, (vertices, faces) in enumerate(parts):
        arrays[f"v{number}"], arrays[f"f{number}"] = np.asarray(vertices, np.float64), np.asarray(faces, np.int32)
    np.savez(scratch / "parts.npz", **arrays)


def _read_bodies(file: Path) -> list[TriangleMesh] | None:
    try:
        with np.load(file, allow_pickle=False) as stored:
            count = sum(name.startswith("v") for name in stored.files)
            parts = [(stored[f"v{k}"], stored[f"f{k}"]) for k in range(count)]
    except (OSError, ValueError, KeyError):
        return None
    return parts or None


def convex_hull(body: TriangleMesh) -> TriangleMesh:
    """Return the convex hull."""
    import manifold3d

    found = manifold3d.Manifold.hull_points(np.asarray(body[0], np.float64)).to_mesh()
    return np.array(found.vert_properties[:, :3], np.float64), np.array(found.tri_verts, np.int32)


def convexity(body: TriangleMesh) -> float:
    """Return a closed body's volume over its convex hull's: 1 if convex."""
    around = uniform_mass_properties(*convex_hull(body)).volume
    return abs(uniform_mass_properties(*body).volume) / around if around > 0 else 1.0
