"""Check mesh file headers before memory is allocated for the content."""

from __future__ import annotations

import json
import math
import re
from typing import Any

from yamsim_cli.core.files.untrusted.refusals import RefusedError

# Bytes per component type, components per accessor type. Source: glTF 2.0 specification, section 3.6.2.2.
_COMPONENT_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_VALUES_PER_ELEMENT = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_PLY_BYTES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "float", "int32", "uint32", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}


def check_header(data: bytes, suffix: str, max_faces: int) -> None:
    """Raise `RefusedError` for more elements than the file can hold, or than `max_faces`."""
    if not data:
        raise RefusedError("empty", "it has no bytes")
    match suffix:
        case ".stl":
            _check_stl_header(data, max_faces)
        case ".ply":
            _check_ply_header(data, max_faces)
        case ".glb":
            _check_glb_header(data, max_faces)
        case ".gltf":
            _check_gltf_tree(_parse_gltf_json(data), None, max_faces)
        case ".obj":
            if len(re.findall(rb"^f\s", data, re.MULTILINE)) > max_faces:
                raise _too_many_faces_error(max_faces)


def _too_many_faces_error(maximum: int) -> RefusedError:
    return RefusedError("too-many-faces", f"it has more than {maximum:,} faces: reduce it first")


def _check_stl_header(data: bytes, maximum: int) -> None:
    count = int.from_bytes(data[80:84], "little")
    if len(data) == 84 + 50 * count and count:
        if count > maximum:
            raise _too_many_faces_error(maximum)
        return
    if not data.lstrip()[:5].lower() == b"solid":
        raise RefusedError(
            "damaged", f"its header gives {count:,} faces, but its bytes hold {max(0, len(data) - 84) // 50:,}"
        )
    if data.count(b"facet normal") > maximum:
        raise _too_many_faces_error(maximum)
    if b"endsolid" not in data:
        raise RefusedError("damaged", "the text is cut off: it has no endsolid")


def _check_ply_header(data: bytes, maximum: int) -> None:
    end = data.find(b"end_header")
    if not data.startswith(b"ply") or end < 0 or end > 100_000:
        raise RefusedError("damaged", "it has no PLY header")
    least, binary, count = 0, b"format ascii" not in data[:end], 0
    for line in data[:end].decode("ascii", "replace").splitlines():
        words = line.split()
        if words[:1] == ["element"]:
            if len(words) != 3 or not words[2].isdecimal():
                raise RefusedError("damaged", f"its header has the line {line.strip()[:60]!r}")
            count = int(words[2])
            if words[1] == "face" and count > maximum:
                raise _too_many_faces_error(maximum)
        elif words[:1] == ["property"] and len(words) >= 3:
            least += count * (_PLY_BYTES.get(words[1] if words[1] != "list" else words[2], 1) if binary else 2)
    if least > len(data) - end:
        raise RefusedError("damaged", f"its header needs {least:,} bytes or more, but {len(data) - end:,} follow")


def _check_glb_header(data: bytes, maximum: int) -> None:
    if data[:4] != b"glTF" or len(data) < 20:
        raise RefusedError("damaged", "it does not begin with the header of a GLB")
    version, total = (int.from_bytes(data[k : k + 4], "little") for k in (4, 8))
    if version != 2 or total > len(data):
        raise RefusedError(
            "damaged", f"its header gives glTF {version} and {total:,} bytes; it has {len(data):,} bytes"
        )
    length = int.from_bytes(data[12:16], "little")
    if data[16:20] != b"JSON" or 20 + length > len(data):
        raise RefusedError("damaged", "its first chunk is not JSON, or is cut off")
    start = 20 + length
    binary = int.from_bytes(data[start : start + 4], "little") if len(data) >= start + 8 else 0
    if start + 8 + binary > len(data) and binary:
        raise RefusedError("damaged", f"its buffer of {binary:,} bytes is cut off")
    _check_gltf_tree(_parse_gltf_json(data[20:start]), binary, maximum)


def _parse_gltf_json(text: bytes) -> Any:
    try:
        tree = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise RefusedError("damaged", f"its JSON cannot be read: {str(error)[:100]}") from error
    if not isinstance(tree, dict):
        raise RefusedError("damaged", "its JSON is not an object")
    return tree


def _check_gltf_tree(tree: Any, binary: int | None, maximum: int) -> None:
    try:
        _check_accessors(tree, binary, maximum)
        _check_node_tree(tree)
    except (TypeError, KeyError, AttributeError, IndexError, ValueError) as error:
        raise RefusedError("damaged", f"its JSON is inconsistent ({type(error).__name__}: {error})") from error


def _check_accessors(tree: Any, binary: int | None, maximum: int) -> None:
    views = tree.get("bufferViews", [])
    for view in views:
        if min(view.get("byteOffset", 0), view["byteLength"], view["buffer"]) < 0:
            raise RefusedError("damaged", "it has a buffer view of negative size")
        size = tree["buffers"][view["buffer"]].get("byteLength", 0)
        own = binary if binary is not None and view["buffer"] == 0 and "uri" not in tree["buffers"][0] else size
        if view.get("byteOffset", 0) + view["byteLength"] > min(size, own + 3):
            raise RefusedError("damaged", "it has a buffer view beyond its buffer")
    for accessor in tree.get("accessors", []):
        count, width = (
            accessor["count"],
            _VALUES_PER_ELEMENT[accessor["type"]] * _COMPONENT_BYTES[accessor["componentType"]],
        )
        if count < 0 or count > 3 * maximum:
            raise _too_many_faces_error(maximum)
        if "bufferView" in accessor:
            view = views[accessor["bufferView"]]
            stride = view.get("byteStride", width)
            if accessor.get("byteOffset", 0) + (count - 1) * stride + width > view["byteLength"]:
                raise RefusedError("damaged", f"an accessor of {count:,} elements reaches beyond its buffer view")
        elif count * width > 3 * maximum:
            raise RefusedError("damaged", "an accessor without a buffer view is too long")


def _check_node_tree(tree: Any) -> None:
    nodes = tree.get("nodes", [])
    if len(nodes) > 10_000:
        raise RefusedError("too-many-faces", f"it has {len(nodes):,} nodes; at most 10,000")
    parents: dict[int, int] = {}
    for number, node in enumerate(nodes):
        for child in node.get("children", []):
            if not 0 <= child < len(nodes):
                raise RefusedError("damaged", f"node {number} has a child that does not exist")
            if child in parents:
                raise RefusedError("cycle", f"node {child} has two parents")
            parents[child] = number
        for key in ("matrix", "translation", "rotation", "scale"):
            if not all(math.isfinite(value) for value in node.get(key, ())):
                raise RefusedError("no-numbers", f"node {number} has a {key} that is not a list of numbers")
    for number in range(len(nodes)):
        at, steps = number, 0
        while at in parents:
            at, steps = parents[at], steps + 1
            if steps > len(nodes):
                raise RefusedError("cycle", "its nodes form a loop")
