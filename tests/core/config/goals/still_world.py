"""A static world for tests of goals."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from yamsim_cli.core.geometry.se3 import Array, pose, rotation_from_vector

SIZE = 0.04


@dataclass
class StillWorld:
    """Cubes of 40 mm at given places (m), with further facts.

    Attributes:
        places: object -> its middle.
        leaning: object -> rotation about x, rad.
        touches: pairs of objects in contact.
        held: object -> sides of the hands that hold it.
        passed: object -> sides of the hands that held it, in order.
        handed: object -> its handovers so far, giver and receiver.
        boxes: object -> sides of its bounding box, m.
        start_boxes: object -> sides of its bounding box at the start, m.
        grams: (filled object, container) -> mass of pieces inside, g.
        shares: (object, container) -> share inside.
        openings: (object, joint) -> share open.
        starts: object -> start.
        marks: (object, handle) -> pose of the handle.
        sheets: cloth -> its points (along y, along x, 3).
    """

    places: Mapping[str, tuple[float, float, float]]
    leaning: Mapping[str, float] = field(default_factory=dict)
    touches: Iterable[tuple[str, str]] = ()
    held: Mapping[str, frozenset[str]] = field(default_factory=dict)
    passed: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    handed: Mapping[str, tuple[tuple[str, str], ...]] = field(default_factory=dict)
    boxes: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    start_boxes: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    grams: Mapping[tuple[str, str], float] = field(default_factory=dict)
    shares: Mapping[tuple[str, str], float] = field(default_factory=dict)
    openings: Mapping[tuple[str, str], float] = field(default_factory=dict)
    starts: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    sheets: Mapping[str, Array] = field(default_factory=dict)
    marks: Mapping[tuple[str, str], Array] = field(default_factory=dict)

    def handle_pose(self, thing: str, handle: str) -> Array:
        return self.marks[thing, handle]

    def pose(self, thing: str) -> Array:
        return pose(self.places[thing], rotation_from_vector([self.leaning.get(thing, 0.0), 0.0, 0.0]))

    def start_pose(self, thing: str) -> Array:
        return pose(self.starts[thing])

    def aabb(self, thing: str) -> tuple[Array, Array]:
        if thing in self.boxes:
            return np.zeros(3), np.array(self.boxes[thing])
        if thing == "table":
            return np.array([-1.0, -1.0, -0.02]), np.array([1.0, 1.0, 0.0])
        middle = np.array(self.places[thing])
        return middle - SIZE / 2, middle + SIZE / 2

    def start_aabb(self, thing: str) -> tuple[Array, Array]:
        return np.zeros(3), np.array(self.start_boxes[thing])

    def grams_inside(self, filled: str, container: str) -> float:
        return self.grams[filled, container]

    def are_touching(self, one: str, other: str) -> bool:
        return (one, other) in self.touches or (other, one) in self.touches

    def holding_sides(self, thing: str) -> frozenset[str]:
        return self.held.get(thing, frozenset())

    def holders_since_rest(self, thing: str) -> tuple[str, ...]:
        return self.passed.get(thing, ())

    def handovers(self, thing: str) -> tuple[tuple[str, str], ...]:
        return self.handed.get(thing, ())

    def volume_fraction_inside(self, thing: str, container: str) -> float:
        return self.shares[thing, container]

    def cloth_points(self, thing: str) -> Array:
        return self.sheets[thing]

    def joint_opening(self, thing: str, joint: str) -> float:
        return self.openings[thing, joint]


def flat_sheet(high: float = 0.0) -> Array:
    """Points (6, 7, 3) of a flat sheet of 20 x 30 cm, one of them `high` m up."""
    x, y = np.meshgrid(np.linspace(0, 0.3, 7), np.linspace(0, 0.2, 6))
    points = np.stack([x, y, np.zeros_like(x)], axis=-1)
    points[2, 3, 2] = high
    return points


def folded_sheet(apart: float, off: float = 0.0, through: float = 0.0) -> Array:
    """Points (6, 7, 3) of a folded sheet of 20 x 30 cm: its upper half is `apart` over the lower one and `off` along y,
    and one corner `through` below the lower one, m.
    """
    x, y = np.meshgrid(np.linspace(0, 0.3, 7), np.linspace(0, 0.2, 6))
    upper = y > 0.1
    points = np.stack([x, np.where(upper, 0.2 - y + off, y), np.where(upper, apart, 0.0)], axis=-1)
    if through:
        points[-1, -1, 2] = -through
    return points
