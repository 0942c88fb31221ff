"""Fits a floor and rings to the inside of bowls, plates and cups."""

from __future__ import annotations

import itertools

import numpy as np

from ..config.things.primitives import Cylinder, Primitive, Ring
from ..geometry.se3 import Array
from .scan import Scan
from .solids import SolidFit, measure

# A vessel is at least this deep, as a share of its height.
_DEEP = 0.3
# A vessel's radius varies by no more than this to either side over all directions, m.
_ROUND = 0.004

# How far the inside may go down again on its way to the rim, m.
_DIP = 0.006

# Directions, seen from the middle of the opening, in which the inside is measured.
_BINS = 64
# How far straight pieces may be from the profile, m: the first of these with which there are few enough pieces.
_TOLERANCES = (0.0008, 0.0012, 0.002, 0.003, 0.005)
_PIECES = 6
_SEGMENTS = 24
# Thinnest wall, m: things could pass through a thinner one.
_LEAST_WALL = 0.002


def fit_hollow(scan: Scan) -> tuple[SolidFit, tuple[float, float]] | None:
    """Floor and rings of a round vessel that stands upright, and the place (x, y) of its axis, m; None if it is none.

    The fit's frame has its origin on the axis, and heights as in the scan.
    """
    low, high = np.percentile(scan.points, (0.2, 99.8), axis=0)
    axis = (low[:2] + high[:2]) / 2
    points = scan.points - [*axis, 0]
    radius = np.hypot(points[:, 0], points[:, 1])
    if not _is_round(points, radius):
        return None
    profile = _profile(points, radius, scan.normals, float(high[2]))
    if profile is None or profile[-1, 1] - profile[0, 1] < _DEEP * (high[2] - low[2]):
        return None
    corners = next(found for tolerance in _TOLERANCES if len(found := _simplified(profile, tolerance)) <= _PIECES + 1)
    parts = _parts(corners, scan.foot, max(scan.wall, _LEAST_WALL))
    return measure(parts, points), (float(axis[0]), float(axis[1]))


def _is_round(points: Array, radius: Array) -> bool:
    """Whether the outermost points in every direction are equally far from the axis."""
    sector = ((np.arctan2(points[:, 1], points[:, 0]) + np.pi) / (2 * np.pi) * 36).astype(int) % 36
    reach = np.array([radius[sector == k].max(initial=0) for k in range(36)])
    return bool(np.ptp(reach) < 2 * _ROUND)


def _profile(points: Array, radius: Array, normals: Array, rim: float) -> Array | None:
    """Radius and height (n, 2) of the inside from its middle outwards; None where there is no inside."""
    outwards = np.einsum("ij,ij->i", normals[:, :2], points[:, :2]) / np.maximum(radius, 1e-9)
    inside = (normals[:, 2] > -0.1) & (outwards < 0.2)
    if not inside.any():
        return None
    # Seen from just above the opening, the inside's parts come in order of this angle, the outermost last.
    angle = np.arctan2(radius[inside], rim + 0.002 - points[inside, 2])
    bins = (angle / angle.max() * (_BINS - 1)).astype(int)
    found = [(radius[inside][bins == k], points[inside, 2][bins == k]) for k in range(_BINS)]
    profile = np.array([(np.median(r), np.median(z)) for r, z in found if len(r) >= 3])
    # This fails for a lid that lies upside down, whose middle is above its edge.
    rises = len(profile) >= 8 and (np.maximum.accumulate(profile[:, 1]) - profile[:, 1]).max() < _DIP
    return profile if rises else None


def _simplified(profile: Array, tolerance: float) -> Array:
    """The corners of straight pieces that are nowhere farther than a tolerance from the profile."""
    start, end = profile[0], profile[-1]
    along = (end - start) / np.linalg.norm(end - start)
    off = np.abs((profile - start) @ np.array([-along[1], along[0]]))
    worst = int(off.argmax())
    if off[worst] <= tolerance or worst in (0, len(profile) - 1):
        return np.array([start, end])
    return np.concatenate([_simplified(profile[: worst + 1], tolerance)[:-1], _simplified(profile[worst:], tolerance)])


def _parts(corners: Array, foot: float, wall: float) -> tuple[Primitive, ...]:
    """The primitives of a profile: a flat floor for its first piece, and rings for the others."""
    top = float(corners[:2, 1].mean())
    edge = float(corners[1, 0])
    half = max((top - foot) / 2, wall / 4)
    floor = Cylinder(type="cylinder", centre=(0.0, 0.0, top - half), radius=edge, half_height=half)
    rings = [
        Ring(
            type="ring",
            # The first ring overlaps the floor, so that there is no gap to fall through.
            inner=(float(r0 if k else edge - wall / 2), float(z0 if k else top)),
            outer=(float(r1), float(z1)),
            thickness=wall,
            segments=_SEGMENTS,
        )
        for k, ((r0, z0), (r1, z1)) in enumerate(itertools.pairwise(corners[1:]))
        if r1 - r0 > 1e-5
    ]
    return (floor, *rings)
