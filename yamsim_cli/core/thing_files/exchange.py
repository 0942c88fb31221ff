"""The files by which a child process hands a read thing to its parent: JSON, plain arrays and PNG.

The parent does not trust the child: arrays are read without pickles, and every number is checked again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .parts import Material, Part, ReadThing, Surface, Weight

_THING, _ARRAYS = "thing.json", "arrays.npz"


def write_thing(thing: ReadThing, folder: Path) -> None:
    """Write a thing into an empty folder."""
    writer = _Writer(folder)
    data = {
        "name": thing.name,
        "fixed": thing.fixed,
        "unit_m": thing.unit_m,
        "up": thing.up,
        "friction": thing.friction,
        "notes": list(thing.notes),
        "parts": [writer.part(part) for part in thing.parts],
    }
    np.savez(folder / _ARRAYS, **writer.arrays)
    (folder / _THING).write_text(json.dumps(data))


def read_written(folder: Path) -> ReadThing:
    """The thing that `write_thing` wrote.

    Raises:
        OSError, ValueError, KeyError, TypeError: the files are missing, incomplete or invalid.
    """
    data = json.loads((folder / _THING).read_bytes())
    with np.load(folder / _ARRAYS, allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files}
    parts = tuple(_part(entry, arrays, folder) for entry in data.pop("parts"))
    return ReadThing(**{**data, "notes": tuple(data["notes"])}, parts=parts)


class _Writer:
    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.arrays: dict[str, Any] = {}
        self._pictures: dict[bytes, str] = {}

    def part(self, part: Part) -> dict[str, Any]:
        weight = part.weight
        return {
            "name": part.name,
            "parent": part.parent,
            "T_in_parent": part.T_in_parent.tolist(),
            "joint": part.joint,
            "weight": weight and [weight.mass, weight.centre.tolist(), weight.tensor.tolist()],
            "looks": [self.surface(surface) for surface in part.looks],
            "shapes": part.shapes
            and [self.surface(shape) if isinstance(shape, Surface) else dict(shape) for shape in part.shapes],
            "handles": [dict(handle) for handle in part.handles],
        }

    def surface(self, surface: Surface) -> dict[str, Any]:
        material = surface.material
        return {
            "surface": True,
            "vertices": self._array(surface.vertices),
            "faces": self._array(surface.faces),
            "uv": None if surface.uv is None else self._array(surface.uv),
            "convex": surface.convex,
            "rgba": list(material.rgba),
            "texture": None if material.texture is None else self._picture(material.texture),
            "specular": material.specular,
            "shininess": material.shininess,
        }

    def _array(self, values: Any) -> str:
        name = f"a{len(self.arrays)}"
        self.arrays[name] = values
        return name

    def _picture(self, data: bytes) -> str:
        name = self._pictures.setdefault(data, f"{len(self._pictures)}.png")
        (self._folder / name).write_bytes(data)
        return name


def _part(entry: Mapping[str, Any], arrays: Mapping[str, Any], folder: Path) -> Part:
    weight = entry["weight"]
    shapes = entry["shapes"]
    return Part(
        entry["name"],
        entry["parent"],
        np.array(entry["T_in_parent"], np.float64).reshape(4, 4),
        entry["joint"],
        weight and Weight(float(weight[0]), np.array(weight[1], np.float64), np.array(weight[2], np.float64)),
        tuple(_surface(look, arrays, folder) for look in entry["looks"]),
        shapes and tuple(_surface(shape, arrays, folder) if shape.get("surface") else shape for shape in shapes),
        tuple(entry["handles"]),
    )


def _surface(entry: Mapping[str, Any], arrays: Mapping[str, Any], folder: Path) -> Surface:
    vertices = np.asarray(arrays[entry["vertices"]], np.float64).reshape(-1, 3)
    faces = np.asarray(arrays[entry["faces"]], np.int32).reshape(-1, 3)
    uv = None if entry["uv"] is None else np.asarray(arrays[entry["uv"]], np.float64).reshape(-1, 3, 2)
    if not np.isfinite(vertices).all() or faces.min(initial=0) < 0 or faces.max(initial=0) >= max(1, len(vertices)):
        raise ValueError("a surface with invalid vertices or triangles")
    picture = entry["texture"]
    texture = None if picture is None else (folder / Path(picture).name).read_bytes()
    red, green, blue, alpha = entry["rgba"]
    material = Material((red, green, blue, alpha), texture, entry["specular"], entry["shininess"])
    return Surface(vertices, faces, material, uv, bool(entry["convex"]))
