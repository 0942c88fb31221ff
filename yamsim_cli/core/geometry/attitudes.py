"""The ways in which a thing can lie still: where rolling on would lift its centre of mass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .hull import directions
from .se3 import Array, rotation_from_vector

_STARTS = 240
_STEPS = 220
# Attitudes of which the centre of mass is equally high are alike, m.
_ALIKE = 4e-4
# Of all directions in which a thing may be let go, a face that it lies on catches at least this share.
_SHARE = 0.04
_MOST = 6
# Directions that differ by less are one way to lie, rad.
_SAME = np.radians(10.0)
# A face on which a hand may put a thing down reaches at least so far out beyond the centre of mass, as a share of its
# height: the thing then stands until it is tipped by 14 degrees.
_STEADY = 0.25
# A face reaches so far out beyond the centre of mass, m; by tipping it so far one sees whether it does, rad.
_FOOT, _TIP = 1e-3, np.radians(3.0)


@dataclass(frozen=True)
class Attitude:
    """One way to lie.

    Attributes:
        down: the direction (3,) in the thing's frame that points to the ground.
        height: of the centre of mass over the ground, m.
        share: of all directions, how many end up like this.
    """

    down: Array
    height: float
    share: float

    @property
    def turn(self) -> Array:
        """The rotation (3, 3) that turns `down` towards the ground."""
        axis = np.cross(self.down, [0, 0, -1])
        sine, cosine = float(np.linalg.norm(axis)), float(-self.down[2])
        if sine < 1e-9:
            return np.eye(3) if cosine > 0 else np.diag([1.0, -1.0, -1.0])
        return rotation_from_vector(axis / sine * np.arctan2(sine, cosine))


def attitudes(points: Array, centre: Array) -> list[Attitude]:
    """Where a body of collision points (n, 3) with a centre of mass (3,) may come to lie: most likely first.

    What rolls has no face where it does.
    """
    rest = _extreme(points - centre)
    down, height = _rolled(rest)
    order = np.argsort(height)
    groups = np.split(order, np.flatnonzero(np.diff(height[order]) > _ALIKE) + 1)
    found = [Attitude(down[group[0]], float(height[group[0]]), len(group) / _STARTS) for group in groups]
    kept = [attitude for attitude in found if attitude.share >= _SHARE and _is_face(rest, attitude)]
    return sorted(kept, key=lambda attitude: -attitude.share)[:_MOST]


def steady_attitudes(points: Array, centre: Array) -> list[Attitude]:
    """Each face on which a body stands so surely that a hand may put it down there: most likely first.

    Unlike in `attitudes`, faces of equal height are each listed: a cube has six.

    Args:
        points: on what collides (n, 3), in the body's frame, m.
        centre: of mass (3,).
    """
    rest = _extreme(points - centre)
    down, height = _rolled(rest)
    found: list[Attitude] = []
    left = np.argsort(height)
    while len(left):
        near = down[left] @ down[left[0]] > np.cos(_SAME)
        found.append(Attitude(down[left[0]], float(height[left[0]]), float(near.sum()) / _STARTS))
        left = left[~near]
    kept = [one for one in found if one.share >= _SHARE and _is_face(rest, one, _STEADY * one.height)]
    return sorted(kept, key=lambda attitude: -attitude.share)


def _rolled(rest: Array) -> tuple[Array, Array]:
    """Where bodies that are let go in any direction end: `down` (n, 3), and the height (n,) of their centres, m."""
    down = directions(_STARTS)
    scale = float(np.linalg.norm(rest, axis=1).max())
    for k in range(_STEPS):
        lowest = rest[(down @ rest.T).argmax(axis=1)]
        # Rolling on: the thing turns about its lowest point until that lies under its centre of mass.
        aside = lowest - np.einsum("ij,ij->i", lowest, down)[:, None] * down
        length = np.linalg.norm(aside, axis=1, keepdims=True)
        step = 0.35 * 0.972**k
        down = down - step * aside / np.maximum(length, 1e-12) * np.minimum(1.0, length / (0.2 * scale) + 0.05)
        down /= np.linalg.norm(down, axis=1, keepdims=True)
    return down, (down @ rest.T).max(axis=1)


def _is_face(rest: Array, attitude: Attitude, foot: float = _FOOT) -> bool:
    """Whether it takes more than a breath to tip it: its foot is so far (m) beyond its centre of mass."""
    aside = np.linalg.svd(attitude.down[None])[2][1:]
    angle = 2 * np.pi * np.arange(12) / 12
    ways = np.column_stack([np.cos(angle), np.sin(angle)]) @ aside
    tipped = np.cos(_TIP) * attitude.down + np.sin(_TIP) * ways
    lift = (tipped @ rest.T).max(axis=1) - attitude.height
    return bool(lift.min() > foot * np.sin(_TIP))


def _extreme(points: Array) -> Array:
    """The points that are farthest out in some direction: the others never touch a plane."""
    far = np.unique((directions(4000) @ points.T).argmax(axis=1))
    found: Array = points[far]
    return found
