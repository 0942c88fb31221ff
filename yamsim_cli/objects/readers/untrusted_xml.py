"""Parse untrusted XML without entities and within limits, with its numbers and rotations."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree

import numpy as np

from yamsim_cli.core.files.untrusted.refusals import RefusedError
from yamsim_cli.core.geometry.se3 import Array

Element = ElementTree.Element

_MAX_BYTES = 64_000_000
_MAX_ELEMENTS = 200_000
_MAX_DEPTH = 64  # nested elements


def parse_untrusted_xml(data: bytes) -> Element:
    """Return a document's root. Raises `RefusedError` if it is no XML, defines entities, or is too large."""
    import defusedxml.ElementTree
    from defusedxml import DefusedXmlException

    if len(data) > _MAX_BYTES:
        raise RefusedError("too-large", f"XML of {len(data) // 10**6} MB; at most {_MAX_BYTES // 10**6}")
    try:
        root: Element = defusedxml.ElementTree.fromstring(data, forbid_dtd=True)
    except DefusedXmlException as error:
        raise RefusedError("xml-entities", "it defines entities or a document type, which are not allowed") from error
    except (ElementTree.ParseError, ValueError, LookupError, RecursionError) as error:
        raise RefusedError("damaged", f"it is not valid XML: {error}") from error
    _check_shape(root)
    return root


def _check_shape(root: Element) -> None:
    level, depth, count = [root], 0, 0
    while level:
        depth, count = depth + 1, count + len(level)
        if depth > _MAX_DEPTH or count > _MAX_ELEMENTS:
            raise RefusedError("too-large", f"it has more than {_MAX_ELEMENTS:,} elements, or {_MAX_DEPTH} levels")
        level = [child for element in level for child in element]
    for element in root.iter():
        if isinstance(element.tag, str):
            element.tag = element.tag.rpartition("}")[2]


def parse_numbers(text: str | None, count: int, default: tuple[float, ...] | None = None) -> list[float]:
    """Return `count` finite numbers, or `default` for an empty text, else raise `RefusedError`."""
    words = (text or "").split()
    if not words and default is not None:
        return list(default)
    try:
        values = [float(word) for word in words]
    except ValueError:
        raise RefusedError("damaged", f"{' '.join(words)[:60]!r} is not a list of numbers") from None
    if len(values) != count:
        raise RefusedError("damaged", f"{' '.join(words)[:60]!r} is not a list of {count} numbers")
    if not all(math.isfinite(value) for value in values):
        raise RefusedError("no-numbers", f"{' '.join(words)[:60]!r} has a number that is not finite")
    return values


def parse_number(text: str | None, default: float | None = None) -> float:
    """Return one finite number, as `parse_numbers`."""
    return parse_numbers(text, 1, None if default is None else (default,))[0]


def collada_asset(data: bytes) -> tuple[float, str]:
    """Return a COLLADA file's unit (m) and up axis, by default 1 m and y. Source: COLLADA 1.4.1, `asset`."""
    root = parse_untrusted_xml(data)
    unit, up = root.find("asset/unit"), root.find("asset/up_axis")
    axis = "" if up is None else (up.text or "").strip()
    metre = parse_number(None if unit is None else unit.get("meter"), 1.0)
    if not 1e-6 <= metre <= 1e4:
        raise RefusedError("impossible", f"its unit is {metre:g} m; valid: 1e-6 to 1e4 m")
    return metre, {"X_UP": "x", "Y_UP": "y", "Z_UP": "z"}.get(axis, "y")


def rotation_from_rpy(roll: float, pitch: float, yaw: float) -> Array:
    """Return the rotation (3, 3) about the fixed x, then y, then z axis, rad, as in SDFormat and URDF."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def inertia_matrix(xx: float, xy: float, xz: float, yy: float, yz: float, zz: float) -> Array:
    """Return the symmetric matrix (3, 3)."""
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
