"""What every way of making a thing gives: surfaces to see, primitives to collide, places to hold it."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..loft import Surface
from ..se3 import Array

# A primitive as a config spells it.
Plain = Mapping[str, Any]

# Thinner walls would let things through, m.
LEAST_WALL = 0.002


@dataclass(frozen=True)
class Piece:
    """A closed surface of one material: its role, such as "body" or "handle", names which."""

    role: str
    surface: Surface


@dataclass(frozen=True)
class Hold:
    """A place that two fingers from above can close on.

    Attributes:
        where: "body", "rim", "edge" or "handle".
        position: middle between the pads (3,), m.
        axis_deg: direction in which the fingers close, degrees from +x.
        width: of what is between them, m.
        flat: whether both pads lie on it with their faces; what they only touch with a line pivots between them.
        tilt_deg: of the hand from straight down, fingers towards `axis_deg`, so that they lie on a wall, degrees; None
            where it is no wall that they lie on.
        depth: how much of it is between the fingers, along them, m: on that they keep it from turning.
    """

    where: str
    position: tuple[float, float, float]
    axis_deg: float
    width: float
    flat: bool = True
    tilt_deg: float | None = None
    depth: float = 0.016


@dataclass(frozen=True)
class Form:
    """A thing as it stands, z up, its origin on the ground under its middle.

    Attributes:
        holds: the best first; none where no hand from above can hold it.
        carries: the preposition of what is put there, "in" or "on".
        support: height of what something put into its middle comes to lie on, m; None where nothing would stay.
        rolls: the least radius of what it touches the ground with, m; 0 where that is flat.
        turned: whether it is the same from all around, so that holds of one kind are as good as each other.
    """

    pieces: tuple[Piece, ...]
    collision: tuple[Plain, ...]
    holds: tuple[Hold, ...]
    carries: str = "on"
    support: float | None = None
    rolls: float = 0.0
    turned: bool = False


def box(centre: Sequence[float], size: Sequence[float], yaw_deg: float = 0.0) -> Plain:
    """A block of a full size (3,), m."""
    plain = {"type": "box", "centre": _plain(centre), "half_size": _plain(np.divide(size, 2))}
    return plain | ({"yaw_deg": yaw_deg} if yaw_deg else {})


def cylinder(low: float, high: float, radius: float) -> Plain:
    """An upright cylinder about the z axis between two heights, m."""
    return {
        "type": "cylinder",
        "centre": [0.0, 0.0, _short((low + high) / 2)],
        "radius": _short(radius),
        "half_height": _short((high - low) / 2),
    }


def sphere(centre: Sequence[float], radius: float) -> Plain:
    """A ball."""
    return {"type": "sphere", "centre": _plain(centre), "radius": _short(radius)}


def capsule(start: ArrayLike, end: ArrayLike, radius: float) -> Plain:
    """A capsule between two points."""
    return {"type": "capsule", "start": _plain(start), "end": _plain(end), "radius": _short(radius)}


def capsules(path: ArrayLike, radius: float, *, closed: bool = False) -> list[Plain]:
    """Capsules along a path (n, 3), and back to its beginning where it is closed."""
    way = list(np.asarray(path, float))
    return [capsule(a, b, radius) for a, b in itertools.pairwise([*way, way[0]] if closed else way)]


def rings(corners: Array, wall: float, segments: int) -> list[Plain]:
    """Rings of boxes under each straight piece of a profile (n, 2) of an inner surface, m."""
    return [
        {
            "type": "ring",
            "inner": _plain(a),
            "outer": _plain(b),
            "thickness": _short(max(wall, LEAST_WALL)),
            "segments": segments,
        }
        for a, b in itertools.pairwise(corners)
    ]


def simplified(profile: Array, tolerance: float) -> Array:
    """The corners (k, n) of straight pieces that stay within a tolerance of a line (m, n)."""
    start, end = profile[0], profile[-1]
    along = (end - start) / max(float(np.linalg.norm(end - start)), 1e-12)
    rest = profile - start
    off = np.linalg.norm(rest - np.outer(rest @ along, along), axis=1)
    worst = int(off.argmax())
    if off[worst] <= tolerance or worst in (0, len(profile) - 1):
        return np.array([start, end])
    return np.concatenate([simplified(profile[: worst + 1], tolerance)[:-1], simplified(profile[worst:], tolerance)])


def _plain(values: ArrayLike) -> list[float]:
    return [_short(float(value)) for value in np.asarray(values, float)]


def _short(value: float) -> float:
    # Adding zero turns a negative one into a plain one.
    return round(float(value), 5) + 0.0
