"""Convex parts of a hollow or branched body, by CoACD in a child process; each body is taken apart once and kept.

Source: X. Wei, M. Liu, Z. Ling, H. Su, "Approximate Convex Decomposition for 3D Meshes with Collision-Aware Concavity
and Tree Search", SIGGRAPH 2022; the package `coacd`.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from ..assets.child import python_call, run_child
from ..assets.sources import SourceError
from ..errors import ResourceError
from ..files import scratch_directory, sha256_bytes, write_file
from ..geometry.closed import is_closed, welded
from ..geometry.se3 import Array
from ..geometry.stl import Faces
from .coarser import coarser

KEPT = "decomposed"

# So many faces are enough for parts that are a millimetre or two off anyway, as long as they stay so near, mm. With
# each one more the search for cuts takes longer.
_ENOUGH = (1_000, 2_000, 4_000, 8_000)
_NEAR_MM = 0.3

# Told of the share that is done, 0 to 1.
Share = Callable[[float], None]
Body = tuple[Array, Faces]


@dataclass(frozen=True)
class Fineness:
    """How finely a body is taken apart; found by trying, see docs/figures.md.

    Attributes:
        threshold: what of its concavity may stay, as a share of half its length.
        parts: how many there may be.
        iterations, nodes, depth, resolution: of the search for each cut.
    """

    threshold: float = 0.05
    parts: int = 32
    iterations: int = 40
    nodes: int = 10
    depth: int = 2
    resolution: int = 1000


# What CoACD takes a body of some thousand faces apart in, s, many times over; and bytes of memory.
LIMIT_S = 300.0
_MEMORY = 8_000_000_000
# Of all cores together, s.
_CORE_SECONDS = 1200


def decompose(
    body: Body, kept: Path, fineness: Fineness | None = None, share: Share = lambda done: None, limit_s: float = LIMIT_S
) -> list[Body]:
    """Convex parts (vertices and triangles each), whose union is nearly the body.

    Args:
        kept: a folder where results are kept, by hash of the body and of everything that decides them.
        limit_s: how long it may take.

    Raises:
        ResourceError: the extra is not installed, or it took too long or too much memory.
    """
    if find_spec("coacd") is None:
        raise ResourceError("taking a body apart needs coacd: pip install 'yamsim[import]', or --collision hull or sdf")
    fineness = fineness or Fineness()
    vertices, faces = welded(*body)
    if is_closed(faces) and (fewer := coarser((vertices, faces), _ENOUGH, _NEAR_MM, closed=True)) is not None:
        vertices, faces = fewer
    how = {**asdict(fineness), "coacd": version("coacd"), "closed": is_closed(faces)}
    source = io.BytesIO()
    np.savez(source, vertices=vertices, faces=faces)
    text = json.dumps(how, sort_keys=True).encode()
    file = kept / f"{sha256_bytes(vertices.tobytes() + faces.tobytes() + text)}.npz"
    if (parts := _read(file)) is not None:
        return parts
    with scratch_directory("yamsim-parts-") as scratch:
        (scratch / "body.npz").write_bytes(source.getvalue())
        (scratch / "how.json").write_bytes(text)
        data = _in_child(scratch, share, limit_s)
    try:
        kept.mkdir(parents=True, exist_ok=True)
        write_file(file, data)
    except OSError as error:
        raise ResourceError(f"{file} cannot be written: {error.strerror}") from error
    parts = _read(file)
    if parts is None:
        raise ResourceError("taking the body apart gave no parts: try --collision sdf")
    return parts


def _in_child(scratch: Path, share: Share, limit_s: float) -> bytes:
    call = python_call("core.things.convex.in_child", str(scratch))

    furthest = 0.0

    def watched() -> int:
        nonlocal furthest
        found = re.findall(r"Processing \[([\d.]+)%\]", (scratch / "stdout.txt").read_text(errors="replace"))
        # It goes through the parts again and again, each time to the end.
        rounds = len(re.findall(r"iter \d+", (scratch / "stdout.txt").read_text(errors="replace")))
        furthest = max(furthest, rounds / (rounds + 3)) if found else furthest
        share(furthest)
        return 0

    try:
        result = run_child(call, scratch, limit_s=limit_s, idle_s=limit_s, watch=watched)
    except SourceError as error:
        raise ResourceError(
            f"taking it apart into convex parts is {error}: reduce the mesh first, or take --collision sdf or hull"
        ) from error
    out = scratch / "parts.npz"
    if result.returncode != 0 or not out.is_file():
        last = (result.stderr.strip().splitlines() or [f"ended with {result.returncode}"])[-1][:200]
        raise ResourceError(f"the body cannot be taken apart into convex parts ({last}): take --collision sdf or hull")
    share(1.0)
    return out.read_bytes()


def in_child(folder: str) -> None:
    """What runs in the child: take the body in a folder apart, and write its parts there."""
    import resource

    import coacd

    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (_CORE_SECONDS, _CORE_SECONDS))
    scratch = Path(folder)
    how = json.loads((scratch / "how.json").read_bytes())
    with np.load(scratch / "body.npz", allow_pickle=False) as body:
        mesh = coacd.Mesh(body["vertices"], body["faces"])
    coacd.set_log_level("info")
    parts = coacd.run_coacd(
        mesh,
        threshold=how["threshold"],
        max_convex_hull=how["parts"],
        # What is closed is taken as it is: remeshing would make many more faces of it.
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


def _read(file: Path) -> list[Body] | None:
    try:
        with np.load(file, allow_pickle=False) as stored:
            count = sum(name.startswith("v") for name in stored.files)
            parts = [(stored[f"v{k}"], stored[f"f{k}"]) for k in range(count)]
    except (OSError, ValueError, KeyError):
        return None
    return parts or None


def hull(body: Body) -> Body:
    """The convex hull of a body."""
    import manifold3d

    found = manifold3d.Manifold.hull_points(np.asarray(body[0], np.float64)).to_mesh()
    return np.array(found.vert_properties[:, :3], np.float64), np.array(found.tri_verts, np.int32)


def convexity(body: Body) -> float:
    """Volume of a closed body as a share of its hull's: 1 where it is convex."""
    from ..geometry.closed import enclosed

    around = enclosed(*hull(body)).volume
    return abs(enclosed(*body).volume) / around if around > 0 else 1.0
