"""Make a YCB object's config from its scan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.config.objects.primitives import Box, Capsule, Cylinder, Primitive, Ring, Sphere
from ..core.files.documents.yaml_document import dump_yaml
from ..core.geometry.se3 import Array
from .overhead_grasps import overhead_grasp
from .primitive_fit import Scan, SolidFit, fit_solid, fit_vessel
from .primitives import PointBody, primitive_data

MIN_VESSEL_DEPTH = 0.03  # m; objects go "in" a vessel at least this deep, else "on" it
# Rolling friction (m) of spheres and capsules over their radius: they stay still on a slope of 3 degrees, as real fruit
# and felt balls do.
ROLLING_FRICTION_SHARE = 0.05
_FRICTION = (0.8, 0.005)  # MuJoCo's: sliding; torsional, m


@dataclass(frozen=True)
class ScannedObject:
    """Data that a scan lacks: `set` and `file` of the scan, and the `source` of name and mass."""

    name: str
    mass_g: float
    rgba: tuple[float, float, float, float]
    set: str
    file: str
    source: str


@dataclass(frozen=True)
class YcbConfig:
    """A config as YAML, its data, and the fit to the scan."""

    yaml: str
    data: dict[str, Any]
    fit: SolidFit


def build_ycb_config(thing: ScannedObject, scan: Scan) -> YcbConfig:
    """Fit primitives to an upright scan, and return the config.

    A vessel's origin is on its axis at its lowest point, any other object's is its centre of mass.
    """
    solid, hollow = fit_solid(scan.points), fit_vessel(scan)
    if hollow and hollow[0].rms < solid.rms:
        fit, axis = hollow
        origin = np.array([*axis, scan.lowest_height])
        parts = tuple(_translate_primitive(part, np.array([0.0, 0.0, -scan.lowest_height])) for part in fit.parts)
    else:
        fit, hollow = solid, None
        low, high = scan.points.min(axis=0) - 0.01, scan.points.max(axis=0) + 0.01
        alone = _primitive_centre_of_mass(fit.parts[0]) if len(fit.parts) == 1 else None
        origin = PointBody.from_primitives(fit.parts, low, high).centre if alone is None else alone
        parts = tuple(_translate_primitive(part, -origin) for part in fit.parts)
    points = scan.points - origin
    body = PointBody.from_primitives(parts, points.min(axis=0) - 0.01, points.max(axis=0) + 0.01)
    moments, quat = body.principal_inertia(thing.mass_g / 1000)
    foot = min(_lowest_height(part) for part in parts)
    data: dict[str, Any] = {
        "name": thing.name,
        "mesh": {"set": thing.set, "file": thing.file, "origin": _round_values(origin), "rgba": list(thing.rgba)},
        "inertia": {
            "mass_g": thing.mass_g,
            "centre": [0.0, 0.0, round(float(body.centre[2]), 5) if hollow else 0.0],
            "diagonal": [float(f"{moment:.3e}") for moment in moments],
            "quat": [round(float(q), 5) for q in quat],
        },
        "contact": _contact_data(parts),
        "collision": [primitive_data(part) for part in parts],
        "rest_height": 0.0 if hollow else round(-foot, 4),
    }
    if hollow and np.ptp(points[:, 2]) >= MIN_VESSEL_DEPTH:
        data["preposition"] = "in"
    if not hollow:
        data["grasp"] = overhead_grasp(body, thing.mass_g / 1000, foot, float(points[:, 2].max()))
    return YcbConfig(_config_comment(thing, parts, fit) + dump_yaml(data), data, fit)


def _config_comment(thing: ScannedObject, parts: tuple[Primitive, ...], fit: SolidFit) -> str:
    kinds = [part.type for part in parts]
    made = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
    return (
        f"# {thing.source}. Written by `yamsim assets import`.\n"
        f"# Fitted to the scan by least squares: {made}; {fit.rms * 1000:.1f} mm off it (rms), 99 % of it within "
        f"{fit.p99 * 1000:.1f} mm.\n"
    )


def _contact_data(parts: tuple[Primitive, ...]) -> dict[str, Any]:
    round_ = [part.radius for part in parts if isinstance(part, Sphere | Capsule)]
    if len(round_) < len(parts):
        return {"friction": [*_FRICTION, 0.0005], "condim": 4}
    return {"friction": [*_FRICTION, round(ROLLING_FRICTION_SHARE * min(round_), 4)], "condim": 6}


def _primitive_centre_of_mass(part: Primitive) -> Array | None:
    """Return a solid's centre of mass (3,), m; None for a ring."""
    match part:
        case Capsule():
            return np.add(part.start, part.end) / 2
        case Ring():
            return None
        case _:
            return np.array(part.centre)


def _translate_primitive(part: Primitive, by: Array) -> Primitive:
    def shift_point(place: tuple[float, float, float]) -> tuple[float, float, float]:
        x, y, z = (round(float(a + b), 5) for a, b in zip(place, by, strict=True))
        return x, y, z

    match part:
        case Capsule():
            return part.model_copy(update={"start": shift_point(part.start), "end": shift_point(part.end)})
        case Ring():
            edges = {key: (getattr(part, key)[0], getattr(part, key)[1] + float(by[2])) for key in ("inner", "outer")}
            return part.model_copy(update=edges)
        case _:
            return part.model_copy(update={"centre": shift_point(part.centre)})


def _lowest_height(part: Primitive) -> float:
    match part:
        case Sphere():
            return part.centre[2] - part.radius
        case Capsule():
            return min(part.start[2], part.end[2]) - part.radius
        case Cylinder():
            return part.centre[2] - part.half_height
        case Box():
            return part.centre[2] - part.half_size[2]
        case Ring():
            return min(part.inner[1], part.outer[1]) - part.thickness


def _round_values(values: Any) -> list[float]:
    return [round(float(value), 5) for value in values]
