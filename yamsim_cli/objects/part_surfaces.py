"""Merge a part's surfaces, reduce their triangles, and compute mass properties."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..core.errors import ResourceError
from ..core.geometry.closed_surface import UniformMassProperties, is_closed, merge_vertices
from ..core.geometry.se3 import Array, quat_from_rotation
from ..core.geometry.stl import Faces
from ..core.geometry.surface_distance import hausdorff_distance
from ..core.scene.assets.asset_lock import Reduction
from ..core.scene.assets.mesh_reduction import collapse_edges
from .readers.object_parts import MassProperties, Surface

_SHEET_THICKNESS = 0.002  # m, of a surface that encloses no volume
_MIN_MOMENT_SHARE = 1e-4  # principal moment over the largest; smaller ones are raised
_MM_PER_M = 1000.0
_SAMPLES = 2000  # points at which a reduced surface's deviation is measured
# mm, displacements, in order, to remove slivers (thin triangles), which can stall the reduction.
_SLIVERS_MM = (0.0, 0.1)


def merged_surface(surfaces: tuple[Surface, ...]) -> tuple[Array, Faces]:
    """Merge a part's surfaces, and vertices at the same position."""
    vertices = np.concatenate([surface.vertices for surface in surfaces])
    starts = np.cumsum([0, *(len(surface.vertices) for surface in surfaces[:-1])])
    faces = np.concatenate([surface.faces + start for surface, start in zip(surfaces, starts, strict=True)])
    return merge_vertices(vertices, faces.astype(np.int32))


def simplified_mesh(
    body: tuple[Array, Faces], counts: Iterable[int], limit_mm: float, *, closed: bool = False
) -> tuple[Array, Faces] | None:
    """Reduce a surface (m) to the first of `counts` triangles that keeps within `limit_mm`; None if none does."""
    source = body[0] * _MM_PER_M, body[1]
    for count in counts:
        if count >= len(body[1]):
            return None
        for slivers in _SLIVERS_MM:
            vertices, faces = collapse_edges(source, Reduction(faces=count, slivers_mm=slivers))
            faces = np.asarray(faces, np.int32)
            if not 4 <= len(faces) < len(body[1]) or (closed and not is_closed(faces)):
                continue
            if hausdorff_distance(source, (vertices, faces), limit_mm, _SAMPLES) <= limit_mm:
                return vertices / _MM_PER_M, faces
    return None


def mass_properties_and_is_solid(vertices: Array, faces: Faces) -> tuple[UniformMassProperties, bool]:
    """Return mass properties at 1 kg/m3, and whether the surface encloses a volume; else it is a sheet."""
    if is_closed(faces):
        inside = _solid_mass_properties(vertices, faces)
        if inside.volume < 0:
            inside = UniformMassProperties(-inside.volume, inside.centre, -inside.inertia)
        if inside.volume > 1e-10:
            return inside, True
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    middles = (a + b + c) / 3
    share = area / max(float(area.sum()), 1e-18)
    centre = share @ middles
    rest = middles - centre
    volume = float(area.sum()) * _SHEET_THICKNESS
    second = volume * (np.einsum("i,ip,iq->pq", share, rest, rest) + _SHEET_THICKNESS**2 / 12 * np.eye(3))
    return UniformMassProperties(volume, centre, np.trace(second) * np.eye(3) - second), False


def _solid_mass_properties(vertices: Array, faces: Faces) -> UniformMassProperties:
    """Return a closed surface's mass properties at 1 kg/m3.

    `closed_surface.uniform_mass_properties` sums in another order. Rounding decides the signs of a symmetric body's
    principal axes, so that order would change existing configs.
    """
    middle = vertices.mean(axis=0)
    a, b, c = np.moveaxis((vertices - middle)[faces], 1, 0)
    six = np.einsum("ij,ij->i", a, np.cross(b, c))
    volume = float(six.sum()) / 6
    if abs(volume) < 1e-18:
        return UniformMassProperties(0.0, middle, np.zeros((3, 3)))
    centre = (six[:, None] * (a + b + c)).sum(axis=0) / 24 / volume
    corners = np.stack([a, b, c], axis=1)
    total = corners.sum(axis=1)
    products = np.einsum("i,ikp,ikq->pq", six, corners, corners) + np.einsum("i,ip,iq->pq", six, total, total)
    second = products / 120 - volume * np.outer(centre, centre)
    return UniformMassProperties(volume, centre + middle, np.trace(second) * np.eye(3) - second)


def plain_inertia(weight: MassProperties, what: str) -> dict[str, object]:
    """Return a config's `inertia`. Raises `ResourceError` if no moment is positive."""
    moments, axes = np.linalg.eigh((weight.tensor + weight.tensor.T) / 2)
    # Files may omit inertia, or round small moments to 0.
    if moments.max() <= 0:
        raise ResourceError(
            f"{what}: its moments of inertia are {moments.tolist()} kg m2, none above 0; "
            "correct the file, or leave the inertia out"
        )
    moments = np.maximum(moments, max(_MIN_MOMENT_SHARE * float(moments.max()), 1e-11))
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return {
        "mass_g": round(weight.mass * 1000, 4),
        "centre": [round(float(x), 6) for x in weight.centre],
        "diagonal": [float(f"{moment:.4e}") for moment in moments],
        "quat": [round(float(q), 6) for q in quat_from_rotation(axes)],
    }
