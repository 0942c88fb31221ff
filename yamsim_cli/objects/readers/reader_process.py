"""Read one object file in a child process with limits, and pass the object on by files.

The parent does not trust the child: it loads arrays without pickle, and checks vertices and triangles again.
"""

from __future__ import annotations

import contextlib
import json
import resource
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from yamsim_cli.core.files.untrusted.confined_folder import MAX_BYTES, ConfinedFolder
from yamsim_cli.core.files.untrusted.refusals import RefusedError

from .object_parts import MassProperties, ObjectDescription, RigidPart, Surface, SurfaceMaterial

REFUSAL_FILE = "refused.json"  # written if the child refuses the file
_DESCRIPTION_FILE, _ARRAYS_FILE = "thing.json", "arrays.npz"

_BASE_BYTES = 3_000_000_000  # bytes, address space of Python and its libraries, mostly only reserved
_MEMORY_FACTOR = 60  # bytes of address space per byte of the file
_MAX_MEMORY = 12_000_000_000  # bytes of address space
_MAX_WRITTEN = 2_000_000_000  # bytes per written file; enough for the largest mesh


def main(file: str, root: str, out: str, seconds: int) -> None:
    """Read `file`, with files in `root` only. Write the object or a refusal to `out`. `seconds` limits CPU time."""
    path = Path(file)
    _set_process_limits(path.stat().st_size, seconds)
    try:
        _write_object(read_file(path, Path(root)), Path(out))
    except RefusedError as error:
        _write_refusal(out, error.code, str(error))
    except MemoryError:
        _write_refusal(out, "too-much-memory", "reading it takes too much memory for a file of its size")
    except RecursionError:
        _write_refusal(out, "damaged", "it is nested too deeply")


def _set_process_limits(size: int, seconds: int) -> None:
    memory = min(_MAX_MEMORY, _BASE_BYTES + _MEMORY_FACTOR * size)
    for kind, limit in (
        (resource.RLIMIT_AS, memory),
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_FSIZE, _MAX_WRITTEN),
        (resource.RLIMIT_CORE, 0),
    ):
        # A lower limit stays.
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(kind, (limit, limit))


def _write_refusal(out: str, code: str, text: str) -> None:
    (Path(out) / REFUSAL_FILE).write_text(json.dumps({"code": code, "text": text}))


def read_file(path: Path, root: Path) -> ObjectDescription:
    """Read a file that may refer to files in `root`. Raises `RefusedError`."""
    folder, base, suffix = ConfinedFolder(root), path.parent.resolve(), path.suffix.lower()
    if path.stat().st_size > MAX_BYTES:
        raise RefusedError("too-large", f"it has more than {MAX_BYTES // 10**6} MB")
    data = folder.read(path.name, base)
    if suffix in (".sdf", ".urdf", ".xml", ".mjcf"):
        return _read_description(data, folder, base)
    from .meshes import read_mesh

    mesh = read_mesh(data, suffix, folder, base)
    part = RigidPart("base", None, np.eye(4), looks=mesh.surfaces)
    return ObjectDescription("", (part,), unit_m=mesh.unit_m, up=mesh.up)


def _read_description(data: bytes, folder: ConfinedFolder, base: Path) -> ObjectDescription:
    """Read a file by its root element, not its ending."""
    from .untrusted_xml import parse_untrusted_xml

    match parse_untrusted_xml(data).tag:
        case "sdf":
            from .sdf import read_sdf

            return read_sdf(data, folder, base)
        case "robot":
            from .urdf import read_urdf

            return read_urdf(data, folder, base)
        case _:
            from .mjcf import read_mjcf

            return read_mjcf(data, folder, base)


def _write_object(thing: ObjectDescription, folder: Path) -> None:
    arrays: dict[str, Any] = {}
    pictures: dict[bytes, str] = {}

    def json_value(value: Any) -> Any:
        if is_dataclass(value):
            return {field.name: json_value(getattr(value, field.name)) for field in fields(value)}
        if isinstance(value, tuple | list):
            return [json_value(item) for item in value]
        if isinstance(value, np.ndarray):
            name = f"a{len(arrays)}"
            arrays[name] = value
            return name
        if isinstance(value, bytes):
            return pictures.setdefault(value, f"{len(pictures)}.png")
        return value

    text = json.dumps(json_value(thing))
    for data, name in pictures.items():
        (folder / name).write_bytes(data)
    np.savez(folder / _ARRAYS_FILE, **arrays)
    (folder / _DESCRIPTION_FILE).write_text(text)


def read_written_object(folder: Path) -> ObjectDescription:
    """Return the object that the child wrote. Raises OSError, ValueError, KeyError or TypeError."""
    data = json.loads((folder / _DESCRIPTION_FILE).read_bytes())
    with np.load(folder / _ARRAYS_FILE, allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files}
    data["parts"] = tuple(_restore_part(entry, arrays, folder) for entry in data["parts"])
    data["notes"] = tuple(data["notes"])
    return ObjectDescription(**data)


def _restore_part(entry: dict[str, Any], arrays: Mapping[str, Any], folder: Path) -> RigidPart:
    if weight := entry["weight"]:
        centre, tensor = (np.asarray(arrays[weight[key]], np.float64) for key in ("centre", "tensor"))
        weight = MassProperties(float(weight["mass"]), centre, tensor)
    shapes = entry["shapes"] and tuple(
        _restore_surface(shape, arrays, folder) if "vertices" in shape else shape for shape in entry["shapes"]
    )
    made: dict[str, Any] = {
        "T_in_parent": np.asarray(arrays[entry["T_in_parent"]], np.float64).reshape(4, 4),
        "weight": weight,
        "looks": tuple(_restore_surface(look, arrays, folder) for look in entry["looks"]),
        "shapes": shapes,
        "handles": tuple(entry["handles"]),
    }
    return RigidPart(**{**entry, **made})


def _restore_surface(entry: Mapping[str, Any], arrays: Mapping[str, Any], folder: Path) -> Surface:
    vertices = np.asarray(arrays[entry["vertices"]], np.float64).reshape(-1, 3)
    faces = np.asarray(arrays[entry["faces"]], np.int32).reshape(-1, 3)
    uv = None if entry["uv"] is None else np.asarray(arrays[entry["uv"]], np.float64).reshape(-1, 3, 2)
    if not np.isfinite(vertices).all() or faces.min(initial=0) < 0 or faces.max(initial=0) >= max(1, len(vertices)):
        raise ValueError("a surface with invalid vertices or triangles")
    material = entry["material"]
    red, green, blue, alpha = material["rgba"]
    texture = None if material["texture"] is None else (folder / Path(material["texture"]).name).read_bytes()
    looks = SurfaceMaterial((red, green, blue, alpha), texture, material["specular"], material["shininess"])
    return Surface(vertices, faces, looks, uv, bool(entry["convex"]))
