"""Meshes with fewer faces, for pictures alone: CAD and scans are finer than any camera here can see.

It takes two steps. A CAD mesh is full of slivers, on which quadric collapse stalls, so slivers are cleared first. What
is left is collapsed to as many faces as the lock says. The result is measured, and not used if it strays too far.
"""

from __future__ import annotations

from importlib.metadata import version

import numpy as np

from ..geometry.deviation import deviation
from ..geometry.se3 import Array
from ..geometry.stl import Faces, read_stl, stl_bytes
from .lock import Reduction

# Largest distance of a reduced mesh from its source, or of the source from it, mm.
LIMIT_MM = 0.5

# How far clearing slivers may move the surface of a mesh for which the lock has no `Reduction`, mm.
_ALONE_MM = 0.2
# Aggressiveness of the collapse, 0 to 10. Below 5 it stalls on CAD meshes, above 7 it tears them.
_BOLDNESS = 6.0
# Points that are measured on each surface; the tests measure twenty times as many.
_SAMPLES = 1000
# STL files hold metres.
_MM = 1000.0

Surface = tuple[Array, Faces]


def recipe() -> str:
    """A text of everything that decides a reduced mesh's bytes, except the source and its `Reduction`.

    Raises:
        ImportError: a library for it is not installed.
    """
    libraries = " ".join(f"{name} {version(name)}" for name in ("manifold3d", "fast-simplification"))
    return f"1 {_ALONE_MM} {_BOLDNESS} {LIMIT_MM} {_SAMPLES} {libraries}"


def reduce_stl(data: bytes, reduction: Reduction | None) -> bytes:
    """A binary STL (metres) of the same body, within `LIMIT_MM` of the surface it is given.

    Returns:
        The reduced mesh, or `data` where every attempt strays too far.

    Raises:
        ResourceError: it is no binary STL.
    """
    vertices, triangles = read_stl(data)
    source = vertices * _MM, triangles
    attempts = [collapsed(source, reduction)] if reduction else []
    for attempt in (*attempts, cleared(source, _ALONE_MM)):
        if len(attempt[1]) < len(triangles) and deviation(source, attempt, LIMIT_MM, _SAMPLES) <= LIMIT_MM:
            return stl_bytes(attempt[0] / _MM, attempt[1])
    return data


def collapsed(source: Surface, reduction: Reduction) -> Surface:
    """The surface with about as many triangles as asked for. Slivers are cleared first. Lengths in mm."""
    import fast_simplification

    vertices, triangles = cleared(source, reduction.slivers_mm)
    if len(triangles) <= reduction.faces:
        return vertices, triangles
    vertices, triangles = fast_simplification.simplify(vertices, triangles, target_count=reduction.faces, agg=_BOLDNESS)
    return vertices, _without_slits(vertices, triangles.astype(np.int32))


def _without_slits(vertices: Array, triangles: Faces) -> Faces:
    """The triangles that still have an area when rounded to the precision of an STL file."""
    a, b, c = np.moveaxis(vertices.astype(np.float32).astype(np.float64)[triangles], 1, 0)
    return triangles[np.cross(b - a, c - a).any(axis=1)]


def cleared(source: Surface, tolerance: float) -> Surface:
    """The surface without slivers, moved by at most about `tolerance`; unchanged if it encloses no body. In mm."""
    import manifold3d

    if not tolerance:
        return source
    vertices, triangles = source
    body = manifold3d.Manifold(manifold3d.Mesh(vertices.astype(np.float32), triangles.astype(np.uint32)))
    if body.status() is not manifold3d.Error.NoError:
        return source
    simple = body.simplify(tolerance).to_mesh()
    return np.array(simple.vert_properties[:, :3], np.float64), np.array(simple.tri_verts, np.int32)
