"""Generates the config of an object from its sizes: meshes, primitives, mass properties and grasps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from ...geometry.closed_surface import uniform_mass_properties
from ...geometry.loft import concatenate_surfaces
from ...geometry.se3 import Array, quat_from_rotation
from ...geometry.shape_generators.generated_shape import GeneratedShape, ShapeGrasp
from ...geometry.stl import encode_stl
from .shapes import DENSITY, Shape

GENERATED_SET = "made"  # name of the asset set for meshes that are generated when a scene is built

_BODY_PIECE = "body"
_SCALE_POWERS = {"_mm": 1, "_g": 3}  # suffix of a shape's key -> power of the scale factor in its value

_SHAPE_ADAPTER: TypeAdapter[Shape] = TypeAdapter(Shape)

_FRICTION = (0.8, 0.005)  # sliding and torsional (m) friction coefficients
_FLAT_FRICTION = 0.0005  # m, rolling friction of flat objects
_ROUND_FRICTION = 0.05  # share of the radius, rolling friction of round objects: holds on a slope of 3 degrees
_CONTACT_TIME_CONSTANT = (
    0.006  # s, time constant of contacts; at MuJoCo's 0.02, thin objects sink into a table after a 10 cm fall
)

_GRAVITY = 9.81  # m/s2
_MIN_FORCE = 15.0  # N, least force of each pad in a grasp
_FORCE_FACTOR = 8.0  # least force of each pad, as a multiple of half the object's weight
_OFF_CENTRE_FORCE_FACTOR = (
    1.2  # multiple of the least pad force that keeps an object, grasped beside its centre of mass, level
)
_MIN_FORCE_FACTOR = 3.0  # multiple of half the weight; with less force of each pad, an object slides out of the pads
# Limits of a pad's force: stiffness of the drive for both pads, N/m; depth of the lowest command below 0 (closed), m;
# force limit of the drive, N. Source: MuJoCo Menagerie yam_linear_4310, `kp`, `ctrlrange` and `forcerange`.
_STIFFNESS, _OVERTRAVEL, _MAX_FORCE = 1000.0, 0.005, 50.0
_WALL_CLEARANCE = 0.006  # m, from an open finger to a grasped wall: the outer one fits between plate rim and table


def generated_mesh_files(name: str, shape: Shape) -> dict[str, bytes]:
    """Return file name -> binary STL (m), one file for each role of pieces, such as the body and the handle."""
    return {
        _mesh_file_name(name, role): encode_stl(*surface)
        for role, surface in _surfaces_by_role(shape.generated_shape()).items()
    }


def object_keys_from_shape(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of an object's config that follow from the sizes in its `shape`; empty without a valid shape."""
    if not isinstance(data.get("shape"), dict):
        return {}
    try:
        shape = _SHAPE_ADAPTER.validate_python(data["shape"])
    except ValidationError:
        return {}  # the validation of the whole config reports the error with its line
    return object_from_shape(str(data.get("name")), shape)


def scaled_shape(shape: Shape, factor: float) -> Shape:
    """Return the shape with all lengths times a factor, and its mass times the cube of the factor.

    Raises ValidationError if the scaled sizes are not valid.
    """
    data = shape.model_dump(mode="json", exclude_none=True)
    return _SHAPE_ADAPTER.validate_python({key: _scaled_value(key, value, factor) for key, value in data.items()})


def _scaled_value(key: str, value: Any, factor: float) -> Any:
    power = next((power for unit, power in _SCALE_POWERS.items() if key.endswith(unit)), 0)
    if not power:
        return value
    return [each * factor**power for each in value] if isinstance(value, list) else value * factor**power


def object_from_shape(name: str, shape: Shape, *, by_wall: bool = False) -> dict[str, Any]:
    """Return the keys of an object's config that follow from a shape: meshes, inertia, contact, collision and grasp.

    With `by_wall`, the config has only grasps of the wall: one finger inside, and one outside.
    """
    form = shape.generated_shape()
    if by_wall:
        form = replace(form, grasps=tuple(hold for hold in form.grasps if hold.tilt_deg is not None))
        assert form.grasps, "a shape that is grasped by its wall has grasps of it"
    mass, centre, inertia = _mass_properties(shape, form)
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    meshes = [_mesh_data(name, role, shape) for role in _surfaces_by_role(form)]
    made: dict[str, Any] = {
        "mesh": meshes[0],
        "meshes": meshes[1:],
        "inertia": {
            "mass_g": round(mass * 1000, 2),
            "centre": [round(float(x), 5) + 0.0 for x in centre],
            "diagonal": [float(f"{moment:.4g}") for moment in moments],
            "quat": [round(float(q), 5) + 0.0 for q in quat_from_rotation(axes)],
        },
        "contact": _contact_data(form),
        "collision": [dict(part) for part in form.collision],
        "rest_height": 0.0,
        "support": form.support_height,
        "preposition": form.preposition,
    }
    if form.grasps:
        made["grasp"] = _grasp_data(form, mass, centre)
    return {key: value for key, value in made.items() if value not in (None, [])}


def _surfaces_by_role(form: GeneratedShape) -> dict[str, Any]:
    roles = sorted({piece.role for piece in form.pieces}, key=lambda role: (role != _BODY_PIECE, role))
    return {role: concatenate_surfaces(piece.surface for piece in form.pieces if piece.role == role) for role in roles}


def _mesh_data(name: str, role: str, shape: Shape) -> dict[str, Any]:
    material = shape.materials[role]
    return {
        "set": GENERATED_SET,
        "file": _mesh_file_name(name, role),
        "origin": [0.0, 0.0, 0.0],
        "rgba": list(material.rgba),
        "specular": material.specular,
        "shininess": material.shininess,
    }


def _mesh_file_name(name: str, role: str) -> str:
    return f"{name}_{role}.stl"


def _mass_properties(shape: Shape, form: GeneratedShape) -> tuple[float, Array, Array]:
    """Return mass (kg), centre of mass (3,) in m, and inertia (3, 3) about it in kg m2, of all pieces."""
    parts = [(uniform_mass_properties(*piece.surface), piece.role) for piece in form.pieces]
    masses = [solid.volume * DENSITY[shape.materials[role].stuff] for solid, role in parts]
    if shape.mass_g is not None:
        masses = [mass * shape.mass_g / 1000 / sum(masses) for mass in masses]
    total = float(sum(masses))
    centre: Array = np.sum([m * solid.centre for m, (solid, _) in zip(masses, parts, strict=True)], axis=0) / total
    inertia = np.zeros((3, 3))
    for mass, (solid, _) in zip(masses, parts, strict=True):
        off = solid.centre - centre
        inertia += solid.inertia * (mass / solid.volume) + mass * (off @ off * np.eye(3) - np.outer(off, off))
    return total, centre, inertia


def _contact_data(form: GeneratedShape) -> dict[str, Any]:
    if form.rolling_radius:
        return {
            "friction": [*_FRICTION, round(_ROUND_FRICTION * form.rolling_radius, 5)],
            "condim": 6,
            "push_out_s": _CONTACT_TIME_CONSTANT,
        }
    return {"friction": [*_FRICTION, _FLAT_FRICTION], "condim": 4, "push_out_s": _CONTACT_TIME_CONSTANT}


def _grasp_data(form: GeneratedShape, mass: float, centre: Array) -> Mapping[str, Any]:
    """Return the data of a grasp by a weld constraint, and of grasps by friction if pads can press hard enough."""
    # In a grasp near the centre of mass, the object rotates less in the pads.
    holds = tuple(sorted(form.grasps, key=lambda hold: round(_lever_arm(hold, centre), 3)))
    held = [hold for hold in holds if hold.has_flat_contact and _min_pad_force(hold, mass, centre) <= _max_force(hold)]
    if form.is_axisymmetric:
        held = [hold for hold in held if hold.grasped_part == held[0].grasped_part]
    best = (held or holds)[0]
    welded = _grasp_point_data(replace(best, tilt_deg=None))
    if not held:
        return welded
    needed = max(
        _MIN_FORCE, _FORCE_FACTOR * mass * _GRAVITY / 2, *(_min_pad_force(hold, mass, centre) for hold in held)
    )
    around = {"around": True} if form.is_axisymmetric and len(held) > 1 else {}
    beside = {"clearance": _WALL_CLEARANCE} if held[0].tilt_deg is not None else {}
    return {
        **welded,
        **beside,
        "friction": {
            "force": round(min(needed, _MAX_FORCE), 1),
            "points": [_grasp_point_data(hold) for hold in held],
            **around,
        },
    }


def _grasp_point_data(hold: ShapeGrasp) -> dict[str, Any]:
    tilt = {"tilt_deg": hold.tilt_deg} if hold.tilt_deg is not None else {}
    return {"position": list(hold.position), "axis_deg": hold.axis_deg, "opening": round(hold.width / 2, 4), **tilt}


def _min_pad_force(hold: ShapeGrasp, mass: float, centre: Array) -> float:
    return (
        mass * _GRAVITY * max(_MIN_FORCE_FACTOR / 2, _OFF_CENTRE_FORCE_FACTOR * _lever_arm(hold, centre) / hold.depth)
    )


def _lever_arm(hold: ShapeGrasp, centre: Array) -> float:
    """Return the horizontal distance of a grasp from the centre of mass (3,), m."""
    return float(np.hypot(*(np.array(hold.position) - centre)[:2]))


def _max_force(hold: ShapeGrasp) -> float:
    return min(_MAX_FORCE, _STIFFNESS * (hold.width / 2 + _OVERTRAVEL))
