"""An object's config and its files, made of a read thing."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ResourceError
from ..geometry.closed import columns
from ..geometry.se3 import Array, quat_from_rotation
from ..thing_files.parts import Part, ReadThing, Weight
from .body import Body
from .convex import Share
from .grasps import grasp
from .looks import Looks, looks_of
from .touch import Touch, lies_on_points, moved, touch_of
from .weigh import Filling, filling, of_density, plain_inertia, scaled, whole
from .wishes import DENSITY, Wishes

_FRICTION = 0.8
# As for things that are fitted with primitives, see `describe`.
_TORSION, _ROLLING, _ROLLS = 0.005, 0.0005, 0.05
# Deeper vessels have things put in them, flatter ones on them, m.
_IN = 0.03
# What is put onto a thing finds a level place: within so much of its middle, no more uneven than so, m.
_MIDDLE, _LEVEL = 0.012, 0.004
_FLAT = 1e-6  # least spread of a base's corners as a share of their largest: STL keeps 7 digits
# Joints that rub on nothing go on for ever; a part of a thing that a file says nothing of.
_RUBS = {"slide": {"damping": 2.0, "friction": 0.3}, "hinge": {"damping": 0.01, "friction": 0.005}}


@dataclass(frozen=True)
class Made:
    """What a thing became.

    Attributes:
        data: an object's config, but for the names of its set; see `with_set`.
        files: file name -> content.
        touches: how its parts touch, the base first.
        mass: of all of it, kg.
        guessed: whether nobody said what it weighs.
        closed: whether every part's surface encloses a body.
        notes: what was left out, for people.
    """

    data: Mapping[str, Any]
    files: Mapping[str, bytes]
    touches: tuple[Touch, ...]
    mass: float
    guessed: bool
    closed: bool
    notes: tuple[str, ...]

    def with_set(self, name: str) -> dict[str, Any]:
        """The config with its files in a set."""

        def named(mesh: Mapping[str, Any]) -> dict[str, Any]:
            return {"set": name, **mesh}

        data = dict(self.data)
        data["mesh"] = named(data["mesh"])
        if "meshes" in data:
            data["meshes"] = [named(mesh) for mesh in data["meshes"]]
        if "links" in data:
            data["links"] = [
                {**link, "meshes": [named(mesh) for mesh in link["meshes"]]} if "meshes" in link else link
                for link in data["links"]
            ]
        return data


def make(thing: ReadThing, wishes: Wishes, kept: Path, share: Share = lambda done: None) -> Made:
    """The config and files of a thing in metres, z up.

    Args:
        kept: where bodies that were taken apart are kept.
        share: told how much of the work is done, 0 to 1.

    Raises:
        ResourceError: no config can be made of it.
    """
    if not thing.parts[0].looks:
        raise ResourceError(f"{wishes.name}: its base {thing.parts[0].name!r} has nothing that can be seen")
    _require_volume(thing, wishes.name)
    labels = _labels(thing)
    fillings = [filling(*whole(part.looks)) if part.looks else None for part in thing.parts]
    weights, guessed = _weights(thing, wishes, fillings)
    bodies = [whole(part.looks) if part.looks else None for part in thing.parts]
    base = bodies[0]
    assert base is not None
    touches = []
    for number, (part, label) in enumerate(zip(thing.parts, labels, strict=True)):
        told = _Share(share, number / len(thing.parts), 1 / len(thing.parts))
        touches.append(touch_of(label, part.looks, part.shapes, wishes.collision, kept, told))
    vessel, level = _hollow(*base), _level(*base)
    origin = _origin(base, weights[0], stands=level is not None)
    friction = wishes.friction or thing.friction or _FRICTION
    looks = [looks_of(f"{label}_look", part.looks) for part, label in zip(thing.parts, labels, strict=True)]
    data: dict[str, Any] = {
        "name": wishes.name,
        **_meshes(looks[0], origin),
        "inertia": plain_inertia(replace(weights[0], centre=weights[0].centre - origin), wishes.name),
        "contact": _contact(touches[0], friction),
        "collision": [moved(part, -origin) for part in touches[0].parts],
        "rest_height": round(max(0.0, float(origin[2]) - _lowest(thing)), 5),
    }
    if level is not None:
        data["support"] = round(max(0.0, level - float(origin[2])), 5)
    if vessel >= _IN:
        data["preposition"] = "in"
    if (wishes.base or ("fixed" if thing.fixed else "free")) == "fixed":
        data["base"] = "fixed"
    if len(thing.parts) > 1:
        data["links"] = [
            _link(thing, number, labels, weights[number], looks[number], touches[number], origin)
            for number in range(1, len(thing.parts))
        ]
    if thing.parts[0].handles:
        data["handles"] = [_shifted(handle, origin) for handle in thing.parts[0].handles]
    data["collision"], files = _files(looks, touches, origin, data["collision"])
    if held := _grasp(base, weights[0].mass, origin):
        data["grasp"] = held
    mass = sum(weight.mass for weight in weights)
    closed = all(held.closed for held in fillings if held is not None)
    return Made(data, files, tuple(touches), mass, guessed, closed, thing.notes)


def _require_volume(thing: ReadThing, name: str) -> None:
    """Refuse a thing whose base lies in one plane or on one line, whatever that plane's direction."""
    vertices = whole(thing.parts[0].looks)[0]
    spread = np.linalg.svd(vertices - vertices.mean(axis=0), compute_uv=False)
    if len(vertices) < 4 or spread[-1] <= _FLAT * spread[0]:
        raise ResourceError(
            f"{name}: all {len(vertices)} corners of its base lie in one plane: no volume; give it a thickness"
        )


@dataclass(frozen=True)
class _Share:
    """One part's share of all the work, told on."""

    share: Share
    start: float
    width: float

    def __call__(self, done: float) -> None:
        self.share(self.start + self.width * done)


def _labels(thing: ReadThing) -> list[str]:
    """A name of letters, digits and underscores for each part; "base" for the base."""
    labels = ["base"]
    for part in thing.parts[1:]:
        label = re.sub(r"\W+", "_", part.name, flags=re.ASCII).strip("_") or "part"
        label = label if label[0].isalpha() else f"part_{label}"
        while label in labels:
            label += "_"
        labels.append(label[:60])
    return labels


def _weights(thing: ReadThing, wishes: Wishes, fillings: list[Filling | None]) -> tuple[list[Weight], bool]:
    """What each part weighs, and whether that is a guess."""
    weights = []
    for part, held in zip(thing.parts, fillings, strict=True):
        if part.weight is not None and wishes.density is None:
            weights.append(part.weight)
        elif held is None:
            raise ResourceError(f"{wishes.name}: part {part.name!r} has neither a weight nor anything to be seen")
        else:
            weights.append(of_density(held.enclosed, wishes.density or DENSITY))
    told = all(part.weight is not None for part in thing.parts)
    if wishes.mass is not None:
        factor = wishes.mass / sum(weight.mass for weight in weights)
        weights = [scaled(weight, factor) for weight in weights]
    return weights, not told and wishes.mass is None and wishes.density is None


def _origin(base: tuple[Array, Any], weight: Weight, *, stands: bool) -> Array:
    """Where a thing's origin is: under its middle where others are put on it, or else its centre of mass; to 10 um."""
    low, high = base[0].min(axis=0), base[0].max(axis=0)
    middle = np.array([*_axis(base), low[2]]) if stands else weight.centre
    origin: Array = np.round(np.clip(middle, low, high), 5)
    return origin


def _axis(base: tuple[Array, Any]) -> Array:
    """Middle (x, y) of the narrowest level of a thing that stands: a handle at its side does not move it."""
    vertices = base[0]
    low, high = vertices[:, 2].min(), vertices[:, 2].max()
    foot = vertices[vertices[:, 2] < low + 0.1 * (high - low)][:, :2]
    middle: Array = (foot.min(axis=0) + foot.max(axis=0)) / 2
    return middle


def _heights(vertices: Array, faces: Any, reach: float) -> Array:
    """Heights of the highest surface at places around the middle; empty where there is none."""
    middle = _axis((vertices, faces))
    ring = [(r * np.cos(a), r * np.sin(a)) for r in (0.25, 0.6, 1.0) for a in np.arange(8) * np.pi / 4 + 0.1]
    found = columns(vertices, faces, middle + reach * np.array([(0.013, 0.017), *ring]))
    return np.array([heights[-1] for heights in found if len(heights)])


def _level(vertices: Array, faces: Any) -> float | None:
    """Height of a level surface in the middle, seen from above, m; None where there is none."""
    heights = _heights(vertices, faces, _MIDDLE)
    if len(heights) < 20 or np.ptp(heights) > _LEVEL:
        return None
    return float(np.median(heights))


def _hollow(vertices: Array, faces: Any) -> float:
    """How deep the middle lies under the rim, m."""
    heights = _heights(vertices, faces, _MIDDLE)
    return float(vertices[:, 2].max() - np.median(heights)) if len(heights) else 0.0


def _lowest(thing: ReadThing) -> float:
    """Height of the lowest point with every joint at 0, in the base's frame, m."""
    poses: list[Array] = []
    lowest = np.inf
    for part in thing.parts:
        T = np.eye(4) if part.parent is None else poses[part.parent] @ part.T_in_parent
        poses.append(T)
        for surface in part.looks:
            lowest = min(lowest, float(surface.moved(T).vertices[:, 2].min()))
    return lowest


def _contact(touch: Touch, friction: float) -> dict[str, Any]:
    if (radius := lies_on_points(touch.parts)) is not None:
        return {"friction": [friction, _TORSION, round(_ROLLS * radius, 4)], "condim": 6}
    return {"friction": [friction, _TORSION, _ROLLING], "condim": 4}


def _meshes(looks: Looks, origin: Array) -> dict[str, Any]:
    entries = [{**mesh, "origin": [float(x) for x in origin]} for mesh in looks.meshes]
    return {"mesh": entries[0], **({"meshes": entries[1:]} if entries[1:] else {})}


def _link(
    thing: ReadThing, number: int, labels: list[str], weight: Weight, looks: Looks, touch: Touch, origin: Array
) -> dict[str, Any]:
    part: Part = thing.parts[number]
    assert part.parent is not None and part.joint is not None  # only the base has none
    shift = origin if part.parent == 0 else np.zeros(3)
    joint = dict(part.joint)
    if not joint.get("damping") and not joint.get("friction"):
        joint |= _RUBS["slide" if joint["type"] == "slide" else "hinge"]
    joint["start"] = min(max(0.0, joint["range"][0]), joint["range"][1])
    link: dict[str, Any] = {
        "name": labels[number],
        **({"parent": labels[part.parent]} if part.parent else {}),
        "position": [round(float(x), 6) for x in part.T_in_parent[:3, 3] - shift],
        "quat": [round(float(q), 8) for q in quat_from_rotation(part.T_in_parent[:3, :3])],
        "joint": {key: _plain(value) for key, value in joint.items()},
        "inertia": plain_inertia(weight, labels[number]),
        "meshes": [{**mesh, "origin": [0.0, 0.0, 0.0]} for mesh in looks.meshes],
        "collision": [dict(entry) for entry in touch.parts],
    }
    if part.handles:
        link["handles"] = [_shifted(handle, np.zeros(3)) for handle in part.handles]
    return link


def _plain(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, 8)
    return [round(float(x), 8) for x in value] if isinstance(value, list | tuple) else value


def _shifted(handle: Mapping[str, Any], origin: Array) -> dict[str, Any]:
    name = re.sub(r"\W+", "_", str(handle["name"]), flags=re.ASCII)
    moved_by = {"position": [round(float(x), 6) for x in np.subtract(handle["position"], origin)]}
    return {**{key: _plain(value) for key, value in handle.items()}, "name": name, **moved_by}


def _files(
    looks: list[Looks], touches: list[Touch], origin: Array, collision: list[dict[str, Any]]
) -> tuple[list[dict[str, Any]], dict[str, bytes]]:
    """All files; those that the base collides by shifted to its origin."""
    from ..geometry.stl import read_stl, stl_bytes

    files: dict[str, bytes] = {}
    for look in looks:
        files |= look.files
    for number, touch in enumerate(touches):
        for name, data in touch.files.items():
            vertices, faces = read_stl(data)
            files[name] = stl_bytes(vertices - origin, faces) if number == 0 else data
    return collision, files


def _grasp(base: tuple[Array, Any], mass: float, origin: Array) -> dict[str, Any] | None:
    """Where two fingers fit around it; None where nothing of it lies between them."""
    body = Body.inside(base[0] - origin, base[1])
    if not len(body.points):
        return None
    heights = base[0][:, 2] - origin[2]
    try:
        return grasp(body, mass, float(heights.min()), float(heights.max()))
    except (ValueError, AssertionError):
        return None
