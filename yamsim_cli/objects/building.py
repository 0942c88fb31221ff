"""Build an object's config and mesh files from the description that a reader returns."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..core.errors import ResourceError
from ..core.geometry.closed_surface import UniformMassProperties
from ..core.geometry.height_map import crossings_along_z
from ..core.geometry.se3 import Array, quat_from_rotation
from ..core.geometry.stl import Faces, decode_stl, encode_stl
from .collision_geometry import CollisionGeometry, CollisionMode, collision_geometry, rolling_radius, shift_part
from .convex_decomposition import ShareCallback
from .overhead_grasps import overhead_grasp
from .part_surfaces import mass_properties_and_is_solid, merged_surface, plain_inertia
from .primitives import PointBody
from .readers.object_parts import MassProperties, ObjectDescription, RigidPart
from .visual_meshes import VisualMeshes, make_visual_meshes
from .ycb_config import MIN_VESSEL_DEPTH, ROLLING_FRICTION_SHARE

_DEFAULT_DENSITY = 1000.0  # kg/m3, if nothing states a mass; close to most plastics, ripe fruit and water
_DEFAULT_FRICTION = 0.8  # sliding
_TORSIONAL_FRICTION, _ROLLING_FRICTION = 0.005, 0.0005  # m; rolling objects use ROLLING_SHARE instead of the latter
# m. A top surface holds objects if its height varies by at most _MAX_UNEVENNESS within _MID_RADIUS.
_MID_RADIUS, _MAX_UNEVENNESS = 0.012, 0.004
_MIN_THICKNESS = 1e-6  # thickness of a base over its extent; a thinner base has no volume
# SI units, for joints whose file states neither: without losses they never come to rest.
_DEFAULT_JOINT_FRICTION = {"slide": {"damping": 2.0, "friction": 0.3}, "hinge": {"damping": 0.01, "friction": 0.005}}


@dataclass(frozen=True)
class ImportOptions:
    """Import options, which override the object file.

    Attributes:
        mass: of the whole object, kg; by default from the density or the file, else from 1,000 kg/m3.
        density: kg/m3, of the evenly filled object.
        collision: "auto" takes the file's geometry, else primitives if they fit, else convex parts.
        base: whether the base can move or is fixed to the world; by default as in the file.
        friction: sliding; by default as in the file, or 0.8.
    """

    name: str
    mass: float | None = None
    density: float | None = None
    collision: CollisionMode = "auto"
    base: Literal["free", "fixed"] | None = None
    friction: float | None = None


@dataclass(frozen=True)
class BuiltObject:
    """The config data and mesh files of an imported object.

    Attributes:
        data: config whose meshes lack the name of their set, which `config_with_mesh_set` adds.
        files: file name -> content.
        collision: of each part, the base first.
        mass: of the whole object, kg.
        mass_is_guessed: a part's mass follows from the default density.
        is_closed: every part's surface is closed.
        notes: for users, on content that was left out.
    """

    data: Mapping[str, Any]
    files: Mapping[str, bytes]
    collision: tuple[CollisionGeometry, ...]
    mass: float
    mass_is_guessed: bool
    is_closed: bool
    notes: tuple[str, ...]

    def config_with_mesh_set(self, name: str) -> dict[str, Any]:
        """Return the config data with `name` as mesh set."""

        def with_mesh_set_name(meshes: list[Mapping[str, Any]]) -> list[dict[str, Any]]:
            return [{"set": name, **mesh} for mesh in meshes]

        data = dict(self.data)
        (data["mesh"],) = with_mesh_set_name([data["mesh"]])
        if "meshes" in data:
            data["meshes"] = with_mesh_set_name(data["meshes"])
        if "links" in data:
            data["links"] = [{**link, "meshes": with_mesh_set_name(link["meshes"])} for link in data["links"]]
        return data


def build_object(
    thing: ObjectDescription, options: ImportOptions, cache: Path, share: ShareCallback = lambda done: None
) -> BuiltObject:
    """Build an object's config and files from a description in metres, z up.

    Raises:
        ResourceError: the description does not suffice for a config.
    """
    if not thing.parts[0].looks:
        raise ResourceError(f"{options.name}: its base {thing.parts[0].name!r} has no visible surface")
    base = merged_surface(thing.parts[0].looks)
    _require_volume(base[0], options.name)
    labels = _part_labels(thing)
    solids = [mass_properties_and_is_solid(*merged_surface(part.looks)) if part.looks else None for part in thing.parts]
    weights = _mass_properties(thing, options, [None if solid is None else solid[0] for solid in solids])
    collision = []
    for number, (part, label) in enumerate(zip(thing.parts, labels, strict=True)):
        part_share = functools.partial(_report_part_progress, share, number, len(thing.parts))
        geometry = collision_geometry(label, part.looks, part.shapes, options.collision, cache, part_share)
        collision.append(geometry)
    depth, level = _rim_depth(*base), _level_surface_height(*base)
    origin = _object_origin(base[0], weights[0], supports_others=level is not None)
    looks = [make_visual_meshes(f"{label}_look", part.looks) for part, label in zip(thing.parts, labels, strict=True)]
    data: dict[str, Any] = {
        "name": options.name,
        **_mesh_entries(looks[0], origin),
        "inertia": plain_inertia(replace(weights[0], centre=weights[0].centre - origin), options.name),
        "contact": _contact_data(collision[0], options.friction or thing.friction or _DEFAULT_FRICTION),
        "collision": [shift_part(part, -origin) for part in collision[0].parts],
        "rest_height": round(max(0.0, float(origin[2]) - _lowest_height(thing)), 5),
    }
    if level is not None:
        data["support"] = round(max(0.0, level - float(origin[2])), 5)
    if depth >= MIN_VESSEL_DEPTH:
        data["preposition"] = "in"
    if (options.base or ("fixed" if thing.fixed else "free")) == "fixed":
        data["base"] = "fixed"
    if len(thing.parts) > 1:
        data["links"] = [
            _link_data(part, labels, number, weights[number], looks[number], collision[number], origin)
            for number, part in enumerate(thing.parts)
            if number
        ]
    if thing.parts[0].handles:
        data["handles"] = [_shift_handle(handle, origin) for handle in thing.parts[0].handles]
    if held := _overhead_grasp_data(base, weights[0].mass, origin):
        data["grasp"] = held
    return BuiltObject(
        data,
        _mesh_files(looks, collision, origin),
        tuple(collision),
        mass=sum(weight.mass for weight in weights),
        mass_is_guessed=options.mass is None
        and options.density is None
        and any(part.weight is None for part in thing.parts),
        is_closed=all(solid[1] for solid in solids if solid is not None),
        notes=thing.notes,
    )


def _report_part_progress(share: ShareCallback, number: int, parts: int, done: float) -> None:
    share(number / parts + 1 / parts * done)


def _require_volume(vertices: Array, name: str) -> None:
    spread = np.linalg.svd(vertices - vertices.mean(axis=0), compute_uv=False)
    if len(vertices) < 4 or spread[-1] <= _MIN_THICKNESS * spread[0]:
        raise ResourceError(f"{name}: all {len(vertices)} vertices of its base lie in one plane; give it a thickness")


def _part_labels(thing: ObjectDescription) -> list[str]:
    labels = ["base"]
    for part in thing.parts[1:]:
        label = re.sub(r"\W+", "_", part.name, flags=re.ASCII).strip("_") or "part"
        label = label if label[0].isalpha() else f"part_{label}"
        while label in labels:
            label += "_"
        labels.append(label[:60])
    return labels


def _mass_properties(
    thing: ObjectDescription, options: ImportOptions, solids: list[UniformMassProperties | None]
) -> list[MassProperties]:
    weights = []
    for part, solid in zip(thing.parts, solids, strict=True):
        if part.weight is not None and options.density is None:
            weights.append(part.weight)
        elif solid is None:
            raise ResourceError(f"{options.name}: part {part.name!r} has neither a mass nor a visible surface")
        else:
            density = options.density or _DEFAULT_DENSITY
            weights.append(MassProperties(solid.volume * density, solid.centre, solid.inertia * density))
    if options.mass is not None:
        factor = options.mass / sum(weight.mass for weight in weights)
        weights = [MassProperties(weight.mass * factor, weight.centre, weight.tensor * factor) for weight in weights]
    return weights


def _object_origin(vertices: Array, weight: MassProperties, *, supports_others: bool) -> Array:
    """Return the origin (3,), m: the underside's middle if `supports_others`, else the centre of mass."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    middle = np.array([*_base_centre(vertices), low[2]]) if supports_others else weight.centre
    origin: Array = np.round(np.clip(middle, low, high), 5)
    return origin


def _base_centre(vertices: Array) -> Array:
    """The lowest tenth excludes a handle at the side."""
    low, high = vertices[:, 2].min(), vertices[:, 2].max()
    foot = vertices[vertices[:, 2] < low + 0.1 * (high - low)][:, :2]
    middle: Array = (foot.min(axis=0) + foot.max(axis=0)) / 2
    return middle


def _surface_heights(vertices: Array, faces: Faces) -> Array:
    ring = [(r * np.cos(a), r * np.sin(a)) for r in (0.25, 0.6, 1.0) for a in np.arange(8) * np.pi / 4 + 0.1]
    found = crossings_along_z(vertices, faces, _base_centre(vertices) + _MID_RADIUS * np.array([(0.013, 0.017), *ring]))
    return np.array([heights[-1] for heights in found if len(heights)])


def _level_surface_height(vertices: Array, faces: Faces) -> float | None:
    heights = _surface_heights(vertices, faces)
    if len(heights) < 20 or np.ptp(heights) > _MAX_UNEVENNESS:
        return None
    return float(np.median(heights))


def _rim_depth(vertices: Array, faces: Faces) -> float:
    heights = _surface_heights(vertices, faces)
    return float(vertices[:, 2].max() - np.median(heights)) if len(heights) else 0.0


def _lowest_height(thing: ObjectDescription) -> float:
    looks = [
        surface.transform(T) for part, T in zip(thing.parts, thing.part_poses(), strict=True) for surface in part.looks
    ]
    return min(float(surface.vertices[:, 2].min()) for surface in looks)


def _contact_data(geometry: CollisionGeometry, friction: float) -> dict[str, Any]:
    if (radius := rolling_radius(geometry.parts)) is not None:
        return {"friction": [friction, _TORSIONAL_FRICTION, round(ROLLING_FRICTION_SHARE * radius, 4)], "condim": 6}
    return {"friction": [friction, _TORSIONAL_FRICTION, _ROLLING_FRICTION], "condim": 4}


def _mesh_entries(looks: VisualMeshes, origin: Array) -> dict[str, Any]:
    first, *others = [{**mesh, "origin": [float(x) for x in origin]} for mesh in looks.meshes]
    return {"mesh": first, **({"meshes": others} if others else {})}


def _link_data(
    part: RigidPart,
    labels: list[str],
    number: int,
    weight: MassProperties,
    looks: VisualMeshes,
    geometry: CollisionGeometry,
    origin: Array,
) -> dict[str, Any]:
    assert part.parent is not None and part.joint is not None
    shift = origin if part.parent == 0 else np.zeros(3)
    joint = dict(part.joint)
    if not joint.get("damping") and not joint.get("friction"):
        joint |= _DEFAULT_JOINT_FRICTION["slide" if joint["type"] == "slide" else "hinge"]
    joint["start"] = min(max(0.0, joint["range"][0]), joint["range"][1])
    link: dict[str, Any] = {
        "name": labels[number],
        **({"parent": labels[part.parent]} if part.parent else {}),
        "position": [round(float(x), 6) for x in part.T_in_parent[:3, 3] - shift],
        "quat": [round(float(q), 8) for q in quat_from_rotation(part.T_in_parent[:3, :3])],
        "joint": {key: _round_value(value) for key, value in joint.items()},
        "inertia": plain_inertia(weight, labels[number]),
        "meshes": [{**mesh, "origin": [0.0, 0.0, 0.0]} for mesh in looks.meshes],
        "collision": [dict(entry) for entry in geometry.parts],
    }
    if part.handles:
        link["handles"] = [_shift_handle(handle, np.zeros(3)) for handle in part.handles]
    return link


def _round_value(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, 8)
    return [round(float(x), 8) for x in value] if isinstance(value, list | tuple) else value


def _shift_handle(handle: Mapping[str, Any], origin: Array) -> dict[str, Any]:
    name = re.sub(r"\W+", "_", str(handle["name"]), flags=re.ASCII)
    position = [round(float(x), 6) for x in np.subtract(handle["position"], origin)]
    return {**{key: _round_value(value) for key, value in handle.items()}, "name": name, "position": position}


def _mesh_files(looks: list[VisualMeshes], collision: list[CollisionGeometry], origin: Array) -> dict[str, bytes]:
    """Return name -> content, with the base's collision meshes shifted by -`origin`."""
    files: dict[str, bytes] = {}
    for look in looks:
        files |= look.files
    for number, geometry in enumerate(collision):
        for name, data in geometry.files.items():
            vertices, faces = decode_stl(data)
            files[name] = encode_stl(vertices - origin, faces) if number == 0 else data
    return files


def _overhead_grasp_data(base: tuple[Array, Faces], mass: float, origin: Array) -> dict[str, Any] | None:
    body = PointBody.from_mesh(base[0] - origin, base[1])
    if not len(body.points):
        return None
    heights = base[0][:, 2] - origin[2]
    try:
        return overhead_grasp(body, mass, float(heights.min()), float(heights.max()))
    except (ValueError, AssertionError):
        return None
