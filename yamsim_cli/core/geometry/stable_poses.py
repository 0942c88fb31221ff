"""Stable poses of rigid bodies: orientations in which any further roll lifts the centre of mass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .closed_surface import sphere_directions
from .se3 import Array, rotation_from_vector

_STARTS, _STEPS = 240, 220  # start orientations from which the body rolls, and steps of each roll
_SAME_HEIGHT = 4e-4  # m, of the centre of mass, below which stable poses count as one
_MIN_SHARE = 0.04  # of the start orientations that end in a stable pose
_MAX_POSES = 6
_SAME_FACE_ANGLE = np.radians(10.0)  # rad, between two downward directions of one face
_MIN_STEADY_RATIO = 0.25  # distance of a face's edge from the centre of mass, over its height: tips at 14 degrees
_MIN_REACH, _TILT = 1e-3, np.radians(3.0)  # m, least such distance for all faces; rad, tilt that tests it


@dataclass(frozen=True)
class StablePose:
    """An orientation in which a body rests.

    Attributes:
        down: unit vector (3,) in the body's frame that points to the ground.
        height: of the centre of mass over the ground, m.
        probability: share of evenly spread start orientations from which the body rolls to this pose.
    """

    down: Array
    height: float
    probability: float

    @property
    def rotation(self) -> Array:
        """Rotation (3, 3) that turns `down` towards the ground."""
        axis = np.cross(self.down, [0, 0, -1])
        sine, cosine = float(np.linalg.norm(axis)), float(-self.down[2])
        if sine < 1e-9:
            return np.eye(3) if cosine > 0 else np.diag([1.0, -1.0, -1.0])
        return rotation_from_vector(axis / sine * np.arctan2(sine, cosine))


def stable_poses(points: Array, centre: Array) -> list[StablePose]:
    """Return the stable poses of a body with collision points (n, 3), m, the most probable first.

    Faces with equal heights of the centre of mass count as one stable pose, so a cube has one. A side on which the body
    rolls is not stable.
    """
    offsets = _extreme_points(points - centre)
    down, height = _resting_directions(offsets)
    order = np.argsort(height)
    groups = np.split(order, np.flatnonzero(np.diff(height[order]) > _SAME_HEIGHT) + 1)
    found = [StablePose(down[group[0]], float(height[group[0]]), len(group) / _STARTS) for group in groups]
    kept = [pose for pose in found if pose.probability >= _MIN_SHARE and _is_supporting_face(offsets, pose)]
    return sorted(kept, key=lambda pose: -pose.probability)[:_MAX_POSES]


def placeable_poses(points: Array, centre: Array) -> list[StablePose]:
    """Return a stable pose for each face on which a hand can place a body, the most probable first; six for a cube."""
    offsets = _extreme_points(points - centre)
    down, height = _resting_directions(offsets)
    found: list[StablePose] = []
    left = np.argsort(height)
    while len(left):
        near = down[left] @ down[left[0]] > np.cos(_SAME_FACE_ANGLE)
        found.append(StablePose(down[left[0]], float(height[left[0]]), float(near.sum()) / _STARTS))
        left = left[~near]
    kept = [
        face
        for face in found
        if face.probability >= _MIN_SHARE and _is_supporting_face(offsets, face, _MIN_STEADY_RATIO * face.height)
    ]
    return sorted(kept, key=lambda pose: -pose.probability)


def _resting_directions(offsets: Array) -> tuple[Array, Array]:
    """Roll a body from each start; return `down` (n, 3) and `height` (n,), m, of the final orientations."""
    down = sphere_directions(_STARTS)
    scale = float(np.linalg.norm(offsets, axis=1).max())
    for k in range(_STEPS):
        lowest = offsets[(down @ offsets.T).argmax(axis=1)]
        # The body rolls about its lowest point until this point is below the centre of mass.
        lever = lowest - np.einsum("ij,ij->i", lowest, down)[:, None] * down
        length = np.linalg.norm(lever, axis=1, keepdims=True)
        step = 0.35 * 0.972**k
        down = down - step * lever / np.maximum(length, 1e-12) * np.minimum(1.0, length / (0.2 * scale) + 0.05)
        down /= np.linalg.norm(down, axis=1, keepdims=True)
    return down, (down @ offsets.T).max(axis=1)


def _is_supporting_face(offsets: Array, pose: StablePose, reach: float = _MIN_REACH) -> bool:
    """Return, by small tilts, whether the supporting face reaches `reach` (m) beyond the centre of mass everywhere."""
    across = np.linalg.svd(pose.down[None])[2][1:]
    angle = 2 * np.pi * np.arange(12) / 12
    tilts = np.column_stack([np.cos(angle), np.sin(angle)]) @ across
    tipped = np.cos(_TILT) * pose.down + np.sin(_TILT) * tilts
    lift = (tipped @ offsets.T).max(axis=1) - pose.height
    return bool(lift.min() > reach * np.sin(_TILT))


def _extreme_points(points: Array) -> Array:
    """Return the points that are extreme in some direction: no other point can touch a plane."""
    far = np.unique((sphere_directions(4000) @ points.T).argmax(axis=1))
    found: Array = points[far]
    return found
