from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..loft import Surface, arc, revolve, shell_profile, tube
from ..se3 import Array
from .generated_shape import (
    GeneratedShape,
    PrimitiveData,
    ShapeGrasp,
    ShapePiece,
    capsules_along,
    cylinder_data,
    ring_boxes,
    simplify_polyline,
    sphere_data,
)

Handles = Literal["none", "loop", "ears"]

_VISUAL_FACES = 48  # around the axis
_BOXES, _FEW_BOXES = 24, 16  # around the axis of a wide and of a narrow vessel
_MAX_NARROW_RADIUS = 0.05  # m, largest radius of a narrow vessel
_TOLERANCE = 0.0010  # m, of collision segments from the profile
_MAX_WIDTH = 0.091  # m, for a grasp across the body: linear_4310 opens 95 mm
_RIM_DEPTH = 0.014  # m, of the finger pads' middle below a grasped rim, so that the rim is above the pads
_HALF_PAD_HEIGHT = 0.008  # m, half the height of a finger pad
_MAX_DEPTH = 0.040  # m below the top; deeper, the palm would touch the top
_NECK_DEPTH = 0.014  # m below the rim, of a grasp on a neck


@dataclass(frozen=True)
class VesselSizes:
    """Sizes of an open vessel, m.

    Attributes:
        diameter: largest outer diameter.
        foot: outer diameter of the bottom.
        wall: thickness of wall and floor.
        flare: exponent of the widening from foot to rim over the height: below 1 a bowl, 1 a cone, above 1 a trumpet.
        fillet: inner radius of the edge between floor and wall.
        neck, shoulder, slope: outer diameter of the neck, if any; height of the body below the neck; height over which
            the body narrows to the neck.
        handles: "none", one upright "loop", or two "ears".
        reach: distance by which handles protrude.
    """

    diameter: float
    height: float
    foot: float
    wall: float
    flare: float = 1.0
    fillet: float = 0.0
    neck: float | None = None
    shoulder: float = 0.0
    slope: float = 0.0
    handles: Handles = "none"
    reach: float = 0.0

    def inner_profile(self) -> Array:
        """Return radius and height (n, 2) of the inner surface from the axis to the rim, m."""
        floor, top = self.wall, self.height - self.wall / 2
        foot, widest = self.foot / 2 - self.wall, self.diameter / 2 - self.wall
        fillet = min(self.fillet, foot * 0.8)
        points = [np.array([[0.0, floor], [foot - fillet, floor]])]
        if fillet:
            points.append(arc((foot - fillet, floor + fillet), fillet, -90, 0)[1:])
        wall_top = self.shoulder if self.neck else top
        share = np.linspace(0, 1, 13)[1:] ** (1.0 / min(self.flare, 1.0))
        z = floor + fillet + share * (wall_top - floor - fillet)
        points.append(np.column_stack([foot + (widest - foot) * share**self.flare, z]))
        if self.neck:
            neck = self.neck / 2 - self.wall
            t = np.linspace(0, 1, 9)[1:]
            blend = (1 - np.cos(np.pi * t)) / 2
            points.append(np.column_stack([widest + (neck - widest) * blend, self.shoulder + self.slope * t]))
            points.append(np.array([[neck, top]]))
        return np.concatenate(points)


def make_vessel(size: VesselSizes) -> GeneratedShape:
    """Return an open vessel that stands on its foot."""
    inside = size.inner_profile()
    pieces = [ShapePiece("body", revolve(shell_profile(inside, size.wall), _VISUAL_FACES))]
    segments = _segment_count(size)
    wall = inside[int(np.flatnonzero(np.diff(inside[:, 1]) > 1e-9)[0]) :]
    collision: list[PrimitiveData] = [cylinder_data(0.0, size.wall, float(wall[0, 0]) + size.wall / 2)]
    collision += ring_boxes(simplify_polyline(wall, _TOLERANCE), size.wall, segments)
    for surface, path, radius in _handle_surfaces(size):
        pieces.append(ShapePiece("handle", surface))
        collision += capsules_along(simplify_polyline(path, _TOLERANCE), radius)
    deep = size.height > 0.03
    grasps, carries = tuple(_vessel_grasps(size, inside)), "in" if deep else "on"
    return GeneratedShape(
        tuple(pieces), tuple(collision), grasps, carries, size.wall, is_axisymmetric=size.handles == "none"
    )


def _segment_count(size: VesselSizes) -> int:
    return _BOXES if size.diameter / 2 > _MAX_NARROW_RADIUS else _FEW_BOXES


def _outer_radius(size: VesselSizes, inside: Array, height: float) -> float:
    wall = inside[np.diff(inside[:, 1], prepend=-1.0) > 1e-9]
    return float(np.interp(height, wall[:, 1], wall[:, 0])) + size.wall


def _handle_surfaces(size: VesselSizes) -> list[tuple[Surface, Array, float]]:
    """Return each handle's surface, centre line (n, 3) and radius, m."""
    inside, top = size.inner_profile(), size.height
    if size.handles == "loop":
        low, high = 0.22 * top, 0.85 * top
        thick = min(0.0065, size.reach / 4)
        start, end = (_outer_radius(size, inside, height) + 0.75 * thick - size.wall for height in (high, low))
        turn = np.linspace(0, np.pi, 15)
        x = np.interp(turn, [0, np.pi], [start, end]) + (size.reach - 1.75 * thick) * np.sin(turn) ** 0.6
        rise = (high + low) / 2 + (high - low) / 2 * np.cos(turn)
        path = np.column_stack([x, np.zeros_like(x), rise])
        return [(tube(path, thick, thick * 0.75, (0, 1, 0)), path, thick * 0.85)]
    if size.handles == "ears":
        thick, z = 0.0055, top - 0.022
        # The round ends are hidden inside the wall.
        radius = _outer_radius(size, inside, z) + thick - size.wall
        half = np.radians(17)
        turn = np.linspace(-1, 1, 15)
        ears = []
        for side in (0.0, np.pi):
            bulge = (size.reach - 2 * thick) * np.clip(np.cos(np.pi / 2 * turn), 0, 1) ** 0.45
            out = radius * np.cos(half * turn) + bulge
            along = radius * np.sin(half * turn)
            path = np.column_stack([np.cos(side) * out, np.cos(side) * along, z + 0.006 * np.cos(np.pi / 2 * turn)])
            ears.append((tube(path, thick, thick, (0, 0, 1)), path, thick))
        return ears
    return []


def _vessel_grasps(size: VesselSizes, inside: Array) -> list[ShapeGrasp]:
    """Return grasps across the body if it fits between the fingers, then at the rim."""
    found: list[ShapeGrasp] = []
    neck = size.neck is not None
    height = max(0.55 * size.height, size.height - _MAX_DEPTH)
    if size.neck and size.neck < 0.06:
        height = size.height - _NECK_DEPTH
    # The pads are parallel to the face of every second collision box.
    around = np.arange(0.0, 360.0, 720.0 / _segment_count(size))
    width = 2 * _outer_radius(size, inside, height)
    if width <= _MAX_WIDTH:
        axes = (90.0 + around[around < 180]) % 180 if size.handles == "none" else (90.0,)
        found += [ShapeGrasp("body", (0.0, 0.0, round(height, 4)), float(axis), round(width, 4)) for axis in axes]
    if not neck or size.neck > 0.05:  # type: ignore[operator]  # a neck that a finger fits into
        radius, z, tilt, bulge = _rim_wall(size, inside)
        for angle in around if size.handles == "none" else (90.0, 270.0):
            turn = np.radians(angle)
            place = (round(radius * float(np.cos(turn)), 4) + 0.0, round(radius * float(np.sin(turn)), 4) + 0.0, z)
            inwards, width = float(angle + 180) % 360, round(size.wall + bulge, 4)
            depth = _RIM_DEPTH + _HALF_PAD_HEIGHT
            found.append(ShapeGrasp("rim", place, inwards, width, tilt_deg=round(math.degrees(tilt), 1), depth=depth))
    return found


def _rim_wall(size: VesselSizes, inside: Array) -> tuple[float, float, float, float]:
    """Return the wall between the pads: radius and height of its middle, m, outward tilt, rad, and bulge, m."""
    wall = inside[np.diff(inside[:, 1], prepend=-1.0) > 1e-9][::-1]
    # The depth is measured along the wall, because the rim of a plate is flat.
    under = np.linalg.norm(wall - wall[0], axis=1)
    middle = min(_RIM_DEPTH, under[-1] / 2)
    places = middle + np.linspace(-1, 1, 9) * min(_HALF_PAD_HEIGHT, middle)
    line = np.column_stack([np.interp(places, under, wall[:, k]) for k in (0, 1)])
    up = (line[0] - line[-1]) / np.linalg.norm(line[0] - line[-1])
    out = np.array([up[1], -up[0]])
    r, z = line[4] + out * size.wall / 2
    return float(r), round(float(z), 4), math.atan2(float(up[0]), float(up[1])), float(np.ptp(line @ out))


def make_cap(diameter: float, height: float, wall: float, grips: int) -> GeneratedShape:
    """Return a screw cap or lid with its hollow side down and `grips` ridges around it; lengths in m."""
    radius = diameter / 2
    top = np.concatenate([[[0.0, height]], arc((radius - 0.0015, height - 0.0015), 0.0015, 90, 0, 4), [[radius, 0.0]]])
    under = np.array([[radius - wall, 0.0], [radius - wall, height - wall], [0.0, height - wall]])
    profile = np.concatenate([top, under])[::-1]
    body = revolve(profile, 96 if grips else _VISUAL_FACES, grips, 0.012 if grips else 0.0)
    skirt = np.array([[radius - wall, 0.0], [radius - wall, height]])
    collision = [cylinder_data(height - wall, height, radius), *ring_boxes(skirt, wall, _FEW_BOXES)]
    width = round(2 * radius, 4)
    z = round(height / 2, 4)
    axes = (90.0, 135.0, 0.0, 45.0) if width <= _MAX_WIDTH else ()
    grasps = tuple(ShapeGrasp("body", (0.0, 0.0, z), axis, width) for axis in axes)
    return GeneratedShape(
        (ShapePiece("body", body),), tuple(collision), grasps, support_height=height, is_axisymmetric=True
    )


def make_fruit(diameter: float, height: float, lobes: int, depth: float, stalk: float) -> GeneratedShape:
    """Return a round fruit with `lobes` bulges of a share `depth` of the radius, and a stalk in a dent on top."""
    turn = np.linspace(-np.pi / 2, np.pi / 2, 33)
    radius = diameter / 2 / (1 + depth) * np.cos(turn) ** 0.85
    z = height / 2 * (1 + np.sin(turn))
    dent = 0.10 * height * np.exp(-((radius / (0.22 * diameter)) ** 2))
    flat = 0.03 * height * np.exp(-((radius / (0.25 * diameter)) ** 2))
    z = np.where(turn > 0, z - dent, z + flat)
    radius[0] = radius[-1] = 0.0
    foot = float(z.min())
    profile = np.column_stack([radius, z - foot])
    top = float(profile[-1, 1])
    pieces = [ShapePiece("body", revolve(profile, 72, lobes, depth))]
    if stalk:
        bend = np.linspace(0, 1, 6)
        path = np.column_stack([0.004 * bend**2, 0 * bend, top - 0.004 + (stalk + 0.004) * bend])
        pieces.append(ShapePiece("stalk", tube(path, 0.0022, 0.0022, (0, 1, 0), 8)))
        leaf = np.linspace(0, 1, 8)
        for k in range(5):
            angle = 2 * np.pi * k / 5
            out = 0.26 * diameter * leaf
            drop = np.interp(out, radius[::-1][:14], profile[::-1, 1][:14])
            line = np.column_stack([out * np.cos(angle), out * np.sin(angle), drop + 0.0012])
            side = (-np.sin(angle), np.cos(angle), 0)
            width = 0.0038 * np.sin(np.pi * np.clip(leaf * 0.9 + 0.08, 0, 1)) + 0.0004
            pieces.append(ShapePiece("stalk", tube(line, width, 0.0007, side, 8)))
    middle = float((profile[:, 1].max()) / 2)
    ball = min(diameter / 2, middle)
    waist = max(diameter / 2 - ball, 0.0)
    parts = [sphere_data((0.0, 0.0, middle), ball)]
    if waist > 0.001:
        around = np.radians(np.arange(0, 360, 45))
        parts = [sphere_data((waist * np.cos(a), waist * np.sin(a), middle), ball) for a in around]
    grasps = [
        ShapeGrasp("body", (0.0, 0.0, round(middle, 4)), axis, round(diameter, 4)) for axis in (90.0, 0.0, 45.0, 135.0)
    ]
    return GeneratedShape(tuple(pieces), tuple(parts), tuple(grasps), rolling_radius=ball, is_axisymmetric=True)
