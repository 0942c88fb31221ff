"""An object's config worked out from its sizes: meshes, primitives, mass and inertia, and where a hand holds it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from ...geometry.forms.form import Form, Hold
from ...geometry.loft import joined
from ...geometry.se3 import Array, quat_from_rotation
from ...geometry.solid import filling
from ...geometry.stl import stl_bytes
from .shapes import DENSITY, Shape

#: Stands for the set of meshes that are made from sizes whenever a scene is composed: no folder holds them.
MADE = "made"

_BODY = "body"
_POWERS = {"_mm": 1, "_g": 3}  # how a key of a shape ends -> power of the scale factor by which its value grows

_SHAPE: TypeAdapter[Shape] = TypeAdapter(Shape)

# Sliding and torsional friction (m) of everything, and rolling friction of what is flat, m.
_FRICTION = (0.8, 0.005)
_FLAT = 0.0005
# Harder than MuJoCo's contacts are: what is thin, let fall from 10 cm, would sink through a table's top, s.
_PUSH_OUT = 0.006
# So much rolling friction, as a share of the radius, keeps what is round still on a slope of 3 degrees.
_ROLLING = 0.05

# What a pad presses with, N: so much at least, so many times half the weight, and so many times what holds level what
# hangs beside the fingers.
_FORCE, _TIMES_WEIGHT, _LEVEL = 15.0, 8.0, 1.2
_G = 9.81
# What a pad can press with: the drive's spring, which both share, ends so far behind closed fingers, N/m, m, N. Source:
# MuJoCo Menagerie yam_linear_4310, `kp`, `ctrlrange` and `forcerange`.
_SPRING, _BEHIND, _MOST = 1000.0, 0.005, 50.0
# How far fingers that come along a wall stay off it, m: the outer one finds room between a plate's rim and the table.
_BESIDE_A_WALL = 0.006
# It slides out of pads that press with less than so many times half its weight.
_SLIDES = 3.0


def made_files(name: str, shape: Shape) -> dict[str, bytes]:
    """File name -> binary STL in m of every material of a thing."""
    return {_file(name, role): stl_bytes(*surface) for role, surface in _surfaces(shape.form()).items()}


def made_from(data: Mapping[str, Any]) -> dict[str, Any]:
    """What follows from the sizes in an object's plain data; nothing where it has none, or not valid ones."""
    if not isinstance(data.get("shape"), dict):
        return {}
    try:
        shape = _SHAPE.validate_python(data["shape"])
    except ValidationError:
        # Checking the whole config names the fault and its line.
        return {}
    return made_object(str(data.get("name")), shape)


def scaled_shape(shape: Shape, factor: float) -> Shape:
    """The shape with all lengths times a factor, and its mass times the cube of the factor.

    Raises:
        ValidationError: no thing can be made in these sizes.
    """
    data = shape.model_dump(mode="json", exclude_none=True)
    return _SHAPE.validate_python({key: _scaled(key, value, factor) for key, value in data.items()})


def _scaled(key: str, value: Any, factor: float) -> Any:
    power = next((power for unit, power in _POWERS.items() if key.endswith(unit)), 0)
    if not power:
        return value
    return [each * factor**power for each in value] if isinstance(value, list) else value * factor**power


def made_object(name: str, shape: Shape) -> dict[str, Any]:
    """What the config of an object says that its sizes decide, as plain data."""
    form = shape.form()
    mass, centre, inertia = _weigh(shape, form)
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    meshes = [_mesh(name, role, shape) for role in _surfaces(form)]
    made: dict[str, Any] = {
        "mesh": meshes[0],
        "meshes": meshes[1:],
        "inertia": {
            "mass_g": round(mass * 1000, 2),
            "centre": [round(float(x), 5) + 0.0 for x in centre],
            "diagonal": [float(f"{moment:.4g}") for moment in moments],
            "quat": [round(float(q), 5) + 0.0 for q in quat_from_rotation(axes)],
        },
        "contact": _contact(form),
        "collision": [dict(part) for part in form.collision],
        "rest_height": 0.0,
        "support": form.support,
        "preposition": form.carries,
    }
    if form.holds:
        made["grasp"] = _grasp(form, mass, centre)
    return {key: value for key, value in made.items() if value not in (None, [])}


def _surfaces(form: Form) -> dict[str, Any]:
    """Role -> everything of that material as one surface; the body first."""
    roles = sorted({piece.role for piece in form.pieces}, key=lambda role: (role != _BODY, role))
    return {role: joined(piece.surface for piece in form.pieces if piece.role == role) for role in roles}


def _mesh(name: str, role: str, shape: Shape) -> dict[str, Any]:
    material = shape.materials[role]
    return {
        "set": MADE,
        "file": _file(name, role),
        "origin": [0.0, 0.0, 0.0],
        "rgba": list(material.rgba),
        "specular": material.specular,
        "shininess": material.shininess,
    }


def _file(name: str, role: str) -> str:
    return f"{name}_{role}.stl"


def _weigh(shape: Shape, form: Form) -> tuple[float, Array, Array]:
    """Mass (kg), centre of mass (3,) and inertia (3, 3) about it, of all pieces and what is in them."""
    parts = [(filling(*piece.surface), piece.role) for piece in form.pieces]
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


def _contact(form: Form) -> dict[str, Any]:
    if form.rolls:
        return {"friction": [*_FRICTION, round(_ROLLING * form.rolls, 5)], "condim": 6, "push_out_s": _PUSH_OUT}
    return {"friction": [*_FRICTION, _FLAT], "condim": 4, "push_out_s": _PUSH_OUT}


def _grasp(form: Form, mass: float, centre: Array) -> Mapping[str, Any]:
    """Where to hold it, and by friction as far as pads can: a weld holds whatever is told to."""
    # The nearer to its weight, the less it turns in the pads.
    holds = tuple(sorted(form.holds, key=lambda hold: round(_lever(hold, centre), 3)))
    held = [hold for hold in holds if hold.flat and _least_force(hold, mass, centre) <= _most_force(hold)]
    if form.turned:
        held = [hold for hold in held if hold.where == held[0].where]
    best = (held or holds)[0]
    welded = _point(replace(best, tilt_deg=None))
    if not held:
        return welded
    needed = max(_FORCE, _TIMES_WEIGHT * mass * _G / 2, *(_least_force(hold, mass, centre) for hold in held))
    around = {"around": True} if form.turned and len(held) > 1 else {}
    beside = {"clearance": _BESIDE_A_WALL} if held[0].tilt_deg is not None else {}
    return {
        **welded,
        **beside,
        "friction": {"force": round(min(needed, _MOST), 1), "points": [_point(hold) for hold in held], **around},
    }


def _point(hold: Hold) -> dict[str, Any]:
    tilt = {"tilt_deg": hold.tilt_deg} if hold.tilt_deg is not None else {}
    return {"position": list(hold.position), "axis_deg": hold.axis_deg, "opening": round(hold.width / 2, 4), **tilt}


def _least_force(hold: Hold, mass: float, centre: Array) -> float:
    """What a pad has to press with, N."""
    return mass * _G * max(_SLIDES / 2, _LEVEL * _lever(hold, centre) / hold.depth)


def _lever(hold: Hold, centre: Array) -> float:
    """How far beside the centre of mass (3,) it is held, m."""
    return float(np.hypot(*(np.array(hold.position) - centre)[:2]))


def _most_force(hold: Hold) -> float:
    """What a pad can press with, N."""
    return min(_MOST, _SPRING * (hold.width / 2 + _BEHIND))
