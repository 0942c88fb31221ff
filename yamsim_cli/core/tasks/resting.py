"""How high a thing comes to lie on another, from what touches of both."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from ..config.things.primitives import Box, Capsule, CollisionPart, Cylinder, HullPart, Ring, SdfPart, Sphere
from ..config.things.thing import ObjectConfig

# Places along a capsule at which it is looked at.
_ALONG = np.linspace(0, 1, 13)


def resting_height(item: ObjectConfig, target: ObjectConfig) -> float:
    """Height (m) of the item's origin over the target's once it is put level onto the target's middle.

    What is longer than a made vessel is wide comes to lie on the wall or the rim. In scanned vessels everything is put
    to the bottom, as in all recordings of them.
    """
    lying = target.support_height + item.rest_height
    rings = [part for part in target.collision if isinstance(part, Ring)]
    if target.shape is None or not rings:
        return lying
    touching = (_top(rings, away) - low for part in item.collision for away, low in _undersides(part))
    return max(lying, *touching)


def _top(rings: list[Ring], away: float) -> float:
    """Height (m) of the walls' upper surface so far from the target's axis, m; far below where there is none."""
    heights = [
        float(np.interp(away, sorted((ring.inner[0], ring.outer[0])), [z for _, z in sorted((ring.inner, ring.outer))]))
        for ring in rings
        if min(ring.inner[0], ring.outer[0]) <= away <= max(ring.inner[0], ring.outer[0]) + ring.thickness
    ]
    return max(heights, default=-math.inf)


def _undersides(part: CollisionPart) -> Iterator[tuple[float, float]]:
    """Places on a primitive's underside: distance from the item's axis, and height over its origin, m."""
    match part:
        case Capsule():
            start, end = np.array(part.start), np.array(part.end)
            for point in start + np.outer(_ALONG, end - start):
                yield from _ball(point, part.radius)
        case Sphere():
            yield from _ball(np.array(part.centre), part.radius)
        case Cylinder():
            x, y, z = part.centre
            yield math.hypot(x, y) + part.radius, z - part.half_height
        case Box() | HullPart() | SdfPart():
            box = part if isinstance(part, Box) else part.around
            for x, y, radius in box.discs:
                yield math.hypot(x, y) + radius, box.centre[2] - box.half_size[2]
        case Ring():
            for radius, height in (part.inner, part.outer):
                yield radius, height - part.thickness


def _ball(centre: np.ndarray, radius: float) -> Iterator[tuple[float, float]]:
    away = math.hypot(centre[0], centre[1])
    yield away, float(centre[2]) - radius
    yield away + radius, float(centre[2])
