"""Cloth that was taken somewhere, lifted, pushed together and dropped: how it lies then."""

from __future__ import annotations

import mujoco
import numpy as np

from ..geometry.se3 import Array, rotation_z
from ..geometry.sheets import crossings
from ..scene.cloth import edges, triangles
from ..scene.compiled import CompiledScene, SceneCloth
from .led import led
from .settle import settle

# What lifts a point of cloth moves so fast, m/s, and so high at least: by the smaller one of so many m, and so much of
# the cloth's half diagonal. It misses the way to the middle by so much at most, rad.
_SPEED = 0.3
_LOWEST, _OF_SMALL = 0.08, 0.3
_ASIDE = 0.5

# Fabric does not pass through itself, nor into what it lies on. Cloth that does after it was dropped, by this share of
# its thickness, or that is not as high as so many layers, is taken anew, so often at most.
_TRIES = 40
_SUNK = 0.5
_CRUMPLED = 4.0

# Crumpled cloth goes on sinking for so many times as long as other things take to come to rest, at most.
_SETTLINGS = 3


def crumpled(
    scene: CompiledScene, start: Array, cloth: str, rng: np.random.Generator, share: float, timestep: float
) -> Array:
    """MuJoCo's positions (nq,) with a cloth at rest that was taken at a point of its outer half, lifted, brought about
    towards its middle, let down half-way, and dropped; anew until it lies as crumpled fabric can.

    Args:
        start: MuJoCo's positions (nq,), in which the cloth lies flat.
        rng: chooses the point, and the way.
        share: how high it is lifted, of the cloth's half diagonal; it is brought by twice that share of the way.
        timestep: of physics, s.
    """
    lying = scene.cloths[cloth]
    ends, corners = edges(*lying.grid), triangles(*lying.grid)
    lowest = float(lying.points(start)[:, 2].min()) - _SUNK * lying.thickness
    faults: list[int] = []
    tried: list[Array] = []
    while len(tried) < _TRIES and 0 not in faults:
        tried.append(_dropped(scene, start, lying, rng, share, timestep))
        points = lying.points(tried[-1])
        low = float(np.ptp(points[:, 2])) < (_CRUMPLED - 1) * lying.thickness
        faults.append(crossings(points, ends, corners) + low + int((points[:, 2] < lowest).sum()))
    return tried[int(np.argmin(faults))]


def _dropped(
    scene: CompiledScene, start: Array, lying: SceneCloth, rng: np.random.Generator, share: float, timestep: float
) -> Array:
    """The same, once, however it lies."""
    points = lying.points(start)
    middle = points.mean(axis=0)
    away = np.linalg.norm(points - middle, axis=1)
    k = int(rng.choice(np.flatnonzero(away > 0.5 * away.max())))
    heading = rng.uniform(-_ASIDE, _ASIDE)
    across = 2 * share * rotation_z(heading)[:2, :2] @ (middle - points[k])[:2]
    up = max(min(_LOWEST, _OF_SMALL * float(away.max())), share * float(away.max()))
    ways = [np.array([0.0, 0.0, up]), np.array([*across, 0.0]), np.array([0.0, 0.0, -up / 2])]
    data = mujoco.MjData(scene.model)
    scene.reset(data, start)
    at = points[[k]]
    with led(scene.model, data, lying, np.array([k])) as lead:
        for way in ways:
            steps = max(1, int(np.linalg.norm(way) / _SPEED / timestep))
            for _ in range(steps):
                at = at + way / steps
                lead(at)
    dropped = start.copy()
    dropped[lying.qpos] = data.qpos[lying.qpos]
    for _ in range(_SETTLINGS):
        dropped = settle(scene, dropped, timestep)
    return dropped
