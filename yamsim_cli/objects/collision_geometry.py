"""Make a part's collision geometry: primitives, convex parts, signed distance field, or convex hull."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..core.geometry.closed_surface import is_closed
from ..core.geometry.se3 import Array
from ..core.geometry.stl import encode_stl
from .convex_decomposition import ShareCallback, TriangleMesh, convex_hull, convexity, decompose_body
from .part_surfaces import merged_surface
from .primitive_fit import Scan, SolidFit, evaluate_fit, fit_solid, fit_vessel
from .primitives import primitive_data
from .readers.object_parts import Surface

CollisionMode = Literal["auto", "primitives", "decompose", "sdf", "hull"]

MAX_PRIMITIVE_DISTANCE = 0.0015  # m; "auto" uses fitted primitives if 99 % of the surface is nearer
_MIN_CONVEXITY = 0.995  # volume over the convex hull's; above, a body counts as convex


@dataclass(frozen=True)
class CollisionGeometry:
    """The collision geometry of a part.

    Attributes:
        kind: "primitives", "decompose" (convex parts), "sdf", "hull", or "file" (from the object file).
        parts: config data.
        files: STL files by name.
        fit: None if no primitives were fitted.
    """

    kind: str
    parts: tuple[Mapping[str, Any], ...]
    files: Mapping[str, bytes]
    fit: SolidFit | None = None


def collision_geometry(
    name: str,
    looks: tuple[Surface, ...],
    shapes: tuple[Mapping[str, Any] | Surface, ...] | None,
    collision: CollisionMode,
    cache: Path,
    share: ShareCallback,
) -> CollisionGeometry:
    """Return a part's collision geometry.

    Args:
        name: prefix of file names.
        looks: visual surfaces.
        shapes: the object file's collision geometry, if any.
        collision: "auto" uses `shapes`, else primitives that fit, else a hull or convex parts.

    Raises:
        ResourceError: a body cannot be decomposed.
    """
    if shapes is not None and collision == "auto":
        return _geometry_from_shapes(name, shapes, cache, share)
    meshes = tuple(shape for shape in shapes or () if isinstance(shape, Surface))
    body = merged_surface(meshes if meshes and len(meshes) == len(shapes or ()) else looks)
    if collision in ("auto", "primitives"):
        fit = fit_primitives(body)
        if collision == "primitives" or fit.p99 <= MAX_PRIMITIVE_DISTANCE:
            return CollisionGeometry("primitives", tuple(primitive_data(part) for part in fit.parts), {}, fit=fit)
    if collision == "sdf":
        return _geometry_from_bodies(name, "sdf", [body])
    if collision == "hull" or (is_closed(body[1]) and convexity(body) > _MIN_CONVEXITY):
        return _geometry_from_bodies(name, "hull", [convex_hull(body)])
    return _geometry_from_bodies(name, "decompose", decompose_body(body, cache, share))


def _geometry_from_shapes(
    name: str, shapes: tuple[Mapping[str, Any] | Surface, ...], cache: Path, share: ShareCallback
) -> CollisionGeometry:
    parts: list[Mapping[str, Any]] = [shape for shape in shapes if not isinstance(shape, Surface)]
    bodies: list[TriangleMesh] = []
    for shape in shapes:
        if isinstance(shape, Surface):
            body = merged_surface((shape,))
            is_convex = shape.convex or (is_closed(body[1]) and convexity(body) > _MIN_CONVEXITY)
            bodies += [convex_hull(body)] if is_convex else decompose_body(body, cache, share)
    made = _geometry_from_bodies(name, "file", bodies)
    return CollisionGeometry("file", (*parts, *made.parts), made.files)


def _geometry_from_bodies(name: str, kind: str, bodies: list[TriangleMesh]) -> CollisionGeometry:
    parts, files = list[Mapping[str, Any]](), {}
    for number, (vertices, faces) in enumerate(bodies):
        file = f"{name}_{'sdf' if kind == 'sdf' else 'part'}_{number}.stl"
        files[file] = encode_stl(vertices, faces)
        low, high = ([round(float(x), 5) for x in corner] for corner in (vertices.min(axis=0), vertices.max(axis=0)))
        parts.append({"type": "sdf" if kind == "sdf" else "hull", "file": file, "low": low, "high": high})
    return CollisionGeometry(kind, tuple(parts), files)


def fit_primitives(body: TriangleMesh) -> SolidFit:
    """Fit solid and hollow primitives, and return those with the smaller rms distance."""
    scan = Scan.from_mesh(*body)
    solid = fit_solid(scan.points)
    found = [evaluate_fit(solid.parts, scan.points)]
    if hollow := fit_vessel(scan):
        fit, (x, y) = hollow
        # A config's ring must lie on the part's z axis.
        if abs(x) < 1e-4 and abs(y) < 1e-4:
            found.append(evaluate_fit(fit.parts, scan.points))
    return min(found, key=lambda fit: fit.rms)


def shift_part(part: Mapping[str, Any], by: Array) -> dict[str, Any]:
    """Shift a part's config data by a vector (3,), m. A ring shifts only along z."""
    at = {
        key: [round(float(x), 6) for x in np.add(part[key], by)]
        for key in ("centre", "start", "end", "low", "high")
        if key in part
    }
    if part["type"] == "ring":
        at = {key: [part[key][0], part[key][1] + float(by[2])] for key in ("inner", "outer")}
    return {**part, **at}


def rolling_radius(parts: tuple[Mapping[str, Any], ...]) -> float | None:
    """Return the least radius if all parts are spheres or capsules, which roll; else None."""
    kinds = {part["type"] for part in parts}
    return min(float(part["radius"]) for part in parts) if kinds <= {"sphere", "capsule"} else None
