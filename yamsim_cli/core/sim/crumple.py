"""Cloth that was taken somewhere, lifted, pushed together and dropped: how it lies then."""

from __future__ import annotations

import mujoco
import numpy as np

from ..geometry.se3 import Array
from ..scene.compiled import CompiledScene
from .watched import settle

# What lifts a point of cloth moves so fast, m/s, and the cloth is let go from at least so high, m.
_SPEED = 0.3
_LOWEST = 0.08


def crumpled(
    scene: CompiledScene, start: Array, cloth: str, rng: np.random.Generator, share: float, timestep: float
) -> Array:
    """MuJoCo's positions (nq,) with a cloth at rest that was taken at a point near its edge, lifted, brought towards
    its middle, and dropped.

    Args:
        start: MuJoCo's positions (nq,), in which the cloth lies flat.
        rng: chooses the point.
        share: how high it is lifted and how far it is brought: of half the cloth's length.
    """
    lying = scene.cloths[cloth]
    points = lying.points(start)
    middle = points.mean(axis=0)
    away = np.linalg.norm(points - middle, axis=1)
    # Any point of the outer half.
    k = int(rng.choice(np.flatnonzero(away > 0.5 * away.max())))
    heading = rng.uniform(-0.5, 0.5)
    R = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    across = 2 * share * R @ (middle - points[k])[:2]
    up = max(_LOWEST, share * float(away.max()))
    ways = [np.array([0.0, 0.0, up]), np.array([*across, 0.0]), np.array([0.0, 0.0, -up / 2])]
    data = mujoco.MjData(scene.model)
    scene.reset(data, start)
    at = data.qpos[lying.qpos[k]].copy()
    for way in ways:
        steps = max(1, int(np.linalg.norm(way) / _SPEED / timestep))
        for _ in range(steps):
            at += way / steps
            data.qpos[lying.qpos[k]], data.qvel[lying.dof[k]] = at, way / (steps * timestep)
            mujoco.mj_step(scene.model, data)
    dropped = start.copy()
    dropped[lying.qpos] = data.qpos[lying.qpos]
    return settle(scene, dropped, timestep)
