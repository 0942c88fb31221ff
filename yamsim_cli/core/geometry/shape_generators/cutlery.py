from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..loft import Surface, concatenate_surfaces, loft, translate_surface, tube
from ..se3 import Array
from .generated_shape import (
    GeneratedShape,
    PrimitiveData,
    ShapeGrasp,
    ShapePiece,
    capsule_data,
    capsules_along,
    simplify_polyline,
)

CutleryKind = Literal["spoon", "fork", "knife", "turner"]

_CLEAR_HEIGHT = 0.018  # m, of the finger pads' middle, at which the pads of a tilted hand clear the table
_SHEET_POINTS, _SHEET_STEPS = 15, 21  # vertices across a curved sheet, and rows of them along it
_MAX_RAISE = 0.004  # m, height of the pads' middle over the handle's middle


@dataclass(frozen=True)
class CutlerySizes:
    """Sizes of a piece of cutlery, m.

    Attributes:
        size: total width, length and height.
        grip: largest width of the handle.
        thickness: of the head.
        handle: thickness of the handle.
    """

    kind: CutleryKind
    size: tuple[float, float, float]
    grip: float
    thickness: float
    handle: float


def make_cutlery(size: CutlerySizes) -> GeneratedShape:
    """Return a piece of cutlery on its back with its head towards +y."""
    head, collision = _HEADS[size.kind](size)
    start = size.size[1] / 2 - _head_length(size)
    path, widths = _handle_line(size, start)
    thick = size.handle / 2
    surface = tube(path, widths, thick, (1, 0, 0), 16)
    rails = simplify_polyline(np.column_stack([path, widths]), 0.0007)
    for sign in (-1, 0, 1):
        rail = rails[:, :3] + np.outer(sign * np.maximum(rails[:, 3] - thick, 0), [1, 0, 0])
        collision += capsules_along(rail, thick)
    pieces = (ShapePiece("body", head), ShapePiece("handle", surface))
    grasps = []
    for share in (0.88, 0.78, 0.68, 0.58, 0.48):
        k = int(share * (len(path) - 1))
        x, y, z = (float(v) for v in path[k])
        place = (round(x, 4), round(y, 4), round(max(z, min(z + _MAX_RAISE, _CLEAR_HEIGHT)), 4))
        grasps.append(ShapeGrasp("handle", place, 0.0, round(2 * float(widths[k]), 4)))
    return GeneratedShape(pieces, tuple(collision), tuple(grasps))


def _head_length(size: CutlerySizes) -> float:
    return {"spoon": 0.32, "fork": 0.33, "knife": 0.54, "turner": 0.32}[size.kind] * size.size[1]


def _handle_line(size: CutlerySizes, start: float) -> tuple[Array, Array]:
    """Return the handle's centre line (n, 3) from its end to the head, and half its width (n,), m."""
    t = np.linspace(0, 1, 25)
    end = -size.size[1] / 2 + size.handle / 2
    y = end + (start + 0.006 - end) * t
    low, high = size.handle / 2, size.size[2] - size.handle / 2
    # The handle rises from its end on the table and falls towards the head, which leaves room for the pads.
    neck = _neck_height(size)
    z = np.interp(t, [0.0, 0.74, 1.0], [low, high, neck])
    z = np.convolve(np.pad(z, 3, mode="edge"), np.ones(7) / 7, mode="valid")
    z = low + (z - z[0]) * (high - low) / (z.max() - z[0])
    z[-1] = neck
    # The sides are straight where the pads grasp.
    narrow = 0.85 if size.kind == "knife" else 0.55
    half = size.grip / 2 * np.interp(t, [0, 0.1, 0.84, 1], [0.7, 1.0, 0.96, narrow])
    return np.column_stack([np.zeros_like(t), y, z]), half


def _neck_height(size: CutlerySizes) -> float:
    return {"spoon": 0.55, "fork": 0.75, "turner": 0.45, "knife": 0.6}[size.kind] * size.size[2]


def _curved_sheet(
    outline_: Callable[[float], tuple[float, float]],
    height: Callable[[Array, float], Array],
    length: tuple[float, float],
    thick: float,
) -> Surface:
    """Return a sheet of thickness `thick`: `outline_` returns its left and right edge, `height` its underside, m."""
    loops = []
    u = np.linspace(-1, 1, _SHEET_POINTS)
    # The steps are shorter at both ends, where outlines are more curved.
    for t in (1 - np.cos(np.linspace(0, np.pi, _SHEET_STEPS))) / 2:
        left, right = outline_(float(t))
        x = (left + right) / 2 + (right - left) / 2 * u
        z = height(x, float(t))
        y = np.full_like(x, length[0] + (length[1] - length[0]) * t)
        above = np.column_stack([x, y, z + thick])
        below = np.column_stack([x, y, z])
        loops.append(np.concatenate([below, above[::-1]]))
    return loft(loops[::-1])


def _spoon_head(size: CutlerySizes) -> tuple[Surface, list[PrimitiveData]]:
    long, wide, thick = _head_length(size), size.size[0], size.thickness
    y0, y1 = size.size[1] / 2 - long, size.size[1] / 2
    deep, neck = 0.40 * size.size[2], _neck_height(size)

    def y_along_head(t: float) -> float:
        # From -1 to 1, faster at the start, for an egg shape with its blunt end at the tip.
        return float(2 * t**0.9 - 1)

    def half_width_at(t: float) -> float:
        return float(wide / 2 * np.sqrt(max(1 - y_along_head(t) ** 2, 0.0)) + 1e-4)

    def rim_height_at(t: float) -> float:
        return float(deep + (neck - thick / 2 - deep) * max(0.0, 1 - t / 0.5) ** 2)

    def height(x: Array, t: float) -> Array:
        hollow = np.maximum(1 - y_along_head(t) ** 2 - (x / (wide / 2)) ** 2, 0.0)
        bottom: Array = np.maximum(rim_height_at(t) - deep * hollow**0.6, 0.0)
        return bottom

    surface = _curved_sheet(lambda t: (-half_width_at(t), half_width_at(t)), height, (y0, y1), thick)
    radius = thick * 0.6
    turn = np.linspace(0.03, 0.97, 8)
    edge = [
        (s * (half_width_at(float(t)) - radius), y0 + long * float(t), rim_height_at(float(t)) + thick - radius)
        for s in (1, -1)
        for t in turn[::s]
    ]
    parts: list[PrimitiveData] = capsules_along(np.array(edge), radius, closed=True)
    # Lengthwise bars form the bottom of the bowl. They are so close that no object falls through.
    for share in (-0.66, -0.33, 0.0, 0.33, 0.66):
        bar = []
        for s in np.linspace(0.1, 0.92, 7):
            x = share * half_width_at(float(s))
            bar.append((x, y0 + long * s, float(height(np.array([x]), float(s))[0]) + radius))
        parts += capsules_along(simplify_polyline(np.array(bar), 0.0006), radius)
    return surface, parts


def _fork_head(size: CutlerySizes) -> tuple[Surface, list[PrimitiveData]]:
    long, wide, thick = _head_length(size), size.size[0], size.thickness
    y0 = size.size[1] / 2 - long
    neck = _neck_height(size)
    root = 0.42

    def height(t: float) -> float:
        # The head touches the table in its middle. Its tips are higher.
        levels = [neck - thick / 2, 0.42 * neck, 0.08 * neck, 0.0, 0.22 * neck]
        return float(np.interp(t, [0, 0.25, 0.5, 0.75, 1], levels))

    def half_width_at(t: float) -> float:
        return float(wide / 2 * np.interp(t / root, [0, 0.3, 0.7, 1], [0.18, 0.45, 0.9, 1.0]))

    palm = _curved_sheet(
        lambda t: (-half_width_at(root * t), half_width_at(root * t)),
        lambda x, t: np.full_like(x, height(root * t)),
        (y0, y0 + root * long),
        thick,
    )
    surfaces, parts = [palm], list[PrimitiveData]()
    radius = thick / 2
    for k in range(4):
        x = wide * (k - 1.5) / 4 * 1.02
        t = np.linspace(root - 0.04, 1, 11)
        path = np.array([(x, y0 + long * s, height(float(s)) + radius) for s in t])
        width = np.interp(t, [root, 0.85, 1], [wide * 0.085, wide * 0.07, wide * 0.025])
        surfaces.append(tube(path - [0, radius, 0], width, radius, (1, 0, 0), 10))
        parts += capsules_along(simplify_polyline(path - [0, radius, 0], 0.0005), radius)
    t = np.linspace(0, root, 5)
    for sign in (-1.0, -0.35, 0.35, 1.0):
        rail = np.array(
            [(sign * (half_width_at(float(s)) - radius), y0 + long * s, height(float(s)) + radius) for s in t]
        )
        parts += capsules_along(rail, radius)
    lift = max(0.0, radius - thick / 2)
    return translate_surface(concatenate_surfaces(surfaces), (0, 0, lift)), parts


def _knife_blade(size: CutlerySizes) -> tuple[Surface, list[PrimitiveData]]:
    long, wide, thick = _head_length(size), size.size[0], size.thickness
    y0, y1 = size.size[1] / 2 - long, size.size[1] / 2
    neck = _neck_height(size)

    def blade_edges_at(t: float) -> tuple[float, float]:
        back = wide / 2 * float(np.interp(t, [0, 0.6, 0.9, 1], [0.55, 0.8, 0.5, 0.05]))
        blade = -wide / 2 * float(np.interp(t, [0, 0.12, 0.7, 0.92, 1], [0.5, 0.95, 1.0, 0.62, 0.0]))
        return blade, back

    def height_at(t: float) -> float:
        # The knife lies on its blade and on the handle's end.
        return float((neck - thick / 2) * max(0.0, 1 - t / 0.3) ** 1.6)

    surface = _curved_sheet(blade_edges_at, lambda x, t: np.full_like(x, height_at(t)), (y0, y1), thick)
    radius = thick / 2
    t = np.concatenate([np.linspace(0.0, 0.3, 4), np.linspace(0.3, 0.99, 5)[1:]])
    parts: list[PrimitiveData] = []
    for share in (0.0, 0.33, 0.67, 1.0):
        rail = []
        for s in t:
            low, high = blade_edges_at(float(s))
            x = low + radius + share * max(high - low - 2 * radius, 0)
            rail.append((x, y0 + (long - radius) * s, height_at(float(s)) + radius))
        parts += capsules_along(simplify_polyline(np.array(rail), 0.0008), radius)
    return surface, parts


def _turner_blade(size: CutlerySizes) -> tuple[Surface, list[PrimitiveData]]:
    long, wide, thick = _head_length(size), size.size[0], size.thickness
    y0, y1 = size.size[1] / 2 - long, size.size[1] / 2
    neck = _neck_height(size)

    def half_width_at(t: float) -> float:
        return float(wide / 2 * np.interp(t, [0, 0.12, 0.35, 0.9, 1], [0.2, 0.35, 0.88, 1.0, 0.93]))

    def height_at(t: float) -> float:
        return float((neck - thick / 2) * max(0.0, 1 - t / 0.5) ** 1.6)

    surface = _curved_sheet(
        lambda t: (-half_width_at(t), half_width_at(t)), lambda x, t: np.full_like(x, height_at(t)), (y0, y1), thick
    )
    radius = thick / 2
    t = np.linspace(0, 1, 9)
    parts: list[PrimitiveData] = []
    for share in (-1.0, -0.6, -0.2, 0.2, 0.6, 1.0):
        rail = [
            (share * (half_width_at(float(s)) - radius), y0 + (long - radius) * s, height_at(float(s)) + radius)
            for s in t
        ]
        parts += capsules_along(simplify_polyline(np.array(rail), 0.0006), radius)
    parts.append(
        capsule_data(
            (-half_width_at(1.0) + radius, y1 - radius, radius),
            (half_width_at(1.0) - radius, y1 - radius, radius),
            radius,
        )
    )
    return surface, parts


_HEADS: Mapping[CutleryKind, Callable[[CutlerySizes], tuple[Surface, list[PrimitiveData]]]] = {
    "spoon": _spoon_head,
    "fork": _fork_head,
    "knife": _knife_blade,
    "turner": _turner_blade,
}
