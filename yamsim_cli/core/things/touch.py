"""How a part touches: primitives where they fit its surface, or else convex parts, its distance, or its hull."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..config.things.primitives import Primitive
from ..geometry.closed import is_closed
from ..geometry.se3 import Array
from ..geometry.stl import stl_bytes
from ..thing_files.parts import Surface
from .convex import Body, Share, convexity, decompose, hull
from .hollows import fit_hollow
from .scan import Scan
from .solids import SolidFit, fit_solid, measure
from .weigh import whole
from .wishes import Collision

# How far primitives may be from the surface, 99 % of it, m.
NEAR = 0.0015
# What fills so much of its hull is convex, as far as a hand can tell.
_CONVEX = 0.995


@dataclass(frozen=True)
class Touch:
    """How a part touches.

    Attributes:
        kind: "primitives", "decompose", "sdf" or "hull"; "file" where it says so itself.
        parts: as configs have them.
        files: name -> STL that the parts name.
        bodies: convex bodies of them, to look into; empty for primitives.
        fit: how far the primitives are from the surface, if any were fitted.
    """

    kind: str
    parts: tuple[Mapping[str, Any], ...]
    files: Mapping[str, bytes]
    bodies: tuple[Body, ...] = ()
    fit: SolidFit | None = None


def touch_of(
    name: str,
    looks: tuple[Surface, ...],
    shapes: tuple[Mapping[str, Any] | Surface, ...] | None,
    wish: Collision,
    kept: Path,
    share: Share,
) -> Touch:
    """How a part is to touch.

    Args:
        name: begins its files' names.
        shapes: what the file says of it, or None.
        kept: where bodies that were taken apart are kept.

    Raises:
        ResourceError: it cannot be made so.
    """
    if shapes is not None and wish == "auto":
        return _as_told(name, shapes, kept, share)
    told = tuple(shape for shape in shapes or () if isinstance(shape, Surface))
    body = whole(told if told and len(told) == len(shapes or ()) else looks)
    if wish in ("auto", "primitives"):
        fit = fitted(body)
        if wish == "primitives" or fit.most <= NEAR:
            return Touch("primitives", tuple(plain(part) for part in fit.parts), {}, fit=fit)
    if wish == "sdf":
        return _of_meshes(name, "sdf", [body])
    if wish == "hull" or (is_closed(body[1]) and convexity(body) > _CONVEX):
        return _of_meshes(name, "hull", [hull(body)])
    return _of_meshes(name, "decompose", decompose(body, kept, share=share))


def _as_told(name: str, shapes: tuple[Mapping[str, Any] | Surface, ...], kept: Path, share: Share) -> Touch:
    parts: list[Mapping[str, Any]] = [shape for shape in shapes if not isinstance(shape, Surface)]
    bodies: list[Body] = []
    for shape in shapes:
        if isinstance(shape, Surface):
            body = whole((shape,))
            is_convex = shape.convex or (is_closed(body[1]) and convexity(body) > _CONVEX)
            bodies += [hull(body)] if is_convex else decompose(body, kept, share=share)
    made = _of_meshes(name, "file", bodies)
    return Touch("file", (*parts, *made.parts), made.files, made.bodies)


def _of_meshes(name: str, kind: str, bodies: list[Body]) -> Touch:
    parts, files = [], {}
    for number, (vertices, faces) in enumerate(bodies):
        file = f"{name}_{'sdf' if kind == 'sdf' else 'part'}_{number}.stl"
        files[file] = stl_bytes(vertices, faces)
        corners = {"low": vertices.min(axis=0), "high": vertices.max(axis=0)}
        parts.append(
            {
                "type": "sdf" if kind == "sdf" else "hull",
                "file": file,
                **{key: [round(float(x), 5) for x in value] for key, value in corners.items()},
            }
        )
    return Touch(kind, tuple(parts), files, tuple(bodies))


def fitted(body: Body) -> SolidFit:
    """The primitives that come closest to a surface, measured over all of it, its hollows too."""
    scan = Scan.of(*body)
    solid = fit_solid(scan.points)
    found = [measure(solid.parts, scan.points)]
    if hollow := fit_hollow(scan):
        fit, (x, y) = hollow
        # Rings are told around the part's own axis.
        if abs(x) < 1e-4 and abs(y) < 1e-4:
            found.append(measure(fit.parts, scan.points))
    return min(found, key=lambda fit: fit.rms)


def plain(part: Primitive) -> dict[str, Any]:
    """A primitive as configs have it, to a hundredth of a millimetre."""
    data: dict[str, Any] = part.model_dump(exclude_none=True)
    return {key: _rounded(value) for key, value in data.items()}


def _rounded(value: Any) -> Any:
    if isinstance(value, tuple | list):
        return [round(float(x), 5) for x in value]
    return round(value, 5) if isinstance(value, float) else value


def moved(part: Mapping[str, Any], by: Array) -> dict[str, Any]:
    """What touches, shifted by so many metres (3,)."""
    at = {
        key: [round(float(x), 6) for x in np.add(part[key], by)]
        for key in ("centre", "start", "end", "low", "high")
        if key in part
    }
    if part["type"] == "ring":
        at = {key: [part[key][0], part[key][1] + float(by[2])] for key in ("inner", "outer")}
    return {**part, **at}


def lies_on_points(parts: tuple[Mapping[str, Any], ...]) -> float | None:
    """The least radius of what is only balls and capsules, which touch the table in points; None otherwise."""
    kinds = {part["type"] for part in parts}
    return min(float(part["radius"]) for part in parts) if kinds <= {"sphere", "capsule"} else None
