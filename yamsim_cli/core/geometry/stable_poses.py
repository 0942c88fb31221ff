"""Resting attitudes of rigid bodies: the orientations in which rolling on would lift the centre of mass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .closed_surface import sphere_directions
from .se3 import Array, rotation_from_vector

_STARTS, _STEPS = 240, 220  # directions in which the body is dropped, and steps of each roll
_ALIKE = 4e-4  # m, difference in the height of the centre of mass below which attitudes are alike
_LEAST_SHARE = 0.04  # least share of the dropped directions that end on a face
_MOST = 6  # attitudes returned
_SAME = np.radians(10.0)  # rad, angle below which two directions are one face
_STEADY = 0.25  # least reach of a face beyond the centre of mass, as a share of its height: tips at 14 degrees
_FOOT, _TIP = 1e-3, np.radians(3.0)  # m, least reach of any face beyond the centre of mass; rad, tilt that tests it


@dataclass(frozen=True)
class StablePose:
    """An orientation in which a body rests.

    Attributes:
        down: direction (3,) in the body's frame that points to the ground.
        height: of the centre of mass over the ground, m.
        probability: of all directions in which the body may be dropped, those that end in this attitude.
    """

    down: Array
    height: float
    probability: float

    @property
    def rotation(self) -> Array:
        """The rotation (3, 3) that turns `down` towards the ground."""
        axis = np.cross(self.down, [0, 0, -1])
        sine, cosine = float(np.linalg.norm(axis)), float(-self.down[2])
        if sine < 1e-9:
            return np.eye(3) if cosine > 0 else np.diag([1.0, -1.0, -1.0])
        return rotation_from_vector(axis / sine * np.arctan2(sine, cosine))


def stable_poses(points: Array, centre: Array) -> list[StablePose]:
    """The attitudes in which a body of collision points (n, 3) and a centre of mass (3,) may rest, likeliest first.

    Faces of equal height count as one attitude: a cube has one. A side on which the body rolls is none.
    """
    rest = _extreme(points - centre)
    down, height = _resting_directions(rest)
    order = np.argsort(height)
    groups = np.split(order, np.flatnonzero(np.diff(height[order]) > _ALIKE) + 1)
    found = [StablePose(down[group[0]], float(height[group[0]]), len(group) / _STARTS) for group in groups]
    kept = [attitude for attitude in found if attitude.probability >= _LEAST_SHARE and _is_face(rest, attitude)]
    return sorted(kept, key=lambda attitude: -attitude.probability)[:_MOST]


def placeable_poses(points: Array, centre: Array) -> list[StablePose]:
    """Each face on which a hand can stand a body, likeliest first; see `attitudes`. A cube has six."""
    rest = _extreme(points - centre)
    down, height = _resting_directions(rest)
    found: list[StablePose] = []
    left = np.argsort(height)
    while len(left):
        near = down[left] @ down[left[0]] > np.cos(_SAME)
        found.append(StablePose(down[left[0]], float(height[left[0]]), float(near.sum()) / _STARTS))
        left = left[~near]
    kept = [face for face in found if face.probability >= _LEAST_SHARE and _is_face(rest, face, _STEADY * face.height)]
    return sorted(kept, key=lambda attitude: -attitude.probability)


def _resting_directions(rest: Array) -> tuple[Array, Array]:
    """Where bodies dropped in all directions come to rest: `down` (n, 3), and the height (n,) of their centres, m."""
    down = sphere_directions(_STARTS)
    scale = float(np.linalg.norm(rest, axis=1).max())
    for k in range(_STEPS):
        lowest = rest[(down @ rest.T).argmax(axis=1)]
        # The body rolls about its lowest point until that point is under the centre of mass.
        lever = lowest - np.einsum("ij,ij->i", lowest, down)[:, None] * down
        length = np.linalg.norm(lever, axis=1, keepdims=True)
        step = 0.35 * 0.972**k
        down = down - step * lever / np.maximum(length, 1e-12) * np.minimum(1.0, length / (0.2 * scale) + 0.05)
        down /= np.linalg.norm(down, axis=1, keepdims=True)
    return down, (down @ rest.T).max(axis=1)


def _is_face(rest: Array, attitude: StablePose, foot: float = _FOOT) -> bool:
    """Whether a small tilt in every direction lifts the centre of mass: the face reaches `foot` (m) beyond it."""
    across = np.linalg.svd(attitude.down[None])[2][1:]
    angle = 2 * np.pi * np.arange(12) / 12
    tilts = np.column_stack([np.cos(angle), np.sin(angle)]) @ across
    tipped = np.cos(_TIP) * attitude.down + np.sin(_TIP) * tilts
    lift = (tipped @ rest.T).max(axis=1) - attitude.height
    return bool(lift.min() > foot * np.sin(_TIP))


def _extreme(points: Array) -> Array:
    """The points that are farthest out in some direction: the others never touch a plane."""
    far = np.unique((sphere_directions(4000) @ points.T).argmax(axis=1))
    found: Array = points[far]
    return found
