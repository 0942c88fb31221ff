"""What would become of cloth if it were pulled: a simulation beside the real one, in which no hand moves."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..geometry.se3 import Array
from ..scene.compiled import SceneCloth
from .led import led

# What is let go comes to rest for so long, s.
_REST = 0.5


def pulled(
    data: mujoco.MjData,
    model: mujoco.MjModel,
    cloth: SceneCloth,
    patches: Sequence[NDArray[np.int_]],
    ways: Sequence[Array],
    arch: float,
    seconds: float,
) -> Array:
    """Where a cloth's points (along y, along x, 3) would be in `world` if patches of it were taken elsewhere, m.

    Args:
        data: as everything is now; it stays so.
        patches: the numbers (n,) of the points that each hand holds.
        ways: where to each patch is brought from where it is (3,), m.
        arch: how high it is lifted between, as a share of the way.
        seconds: how long that takes.
    """
    imagined = mujoco.MjData(model)
    mujoco.mj_copyData(imagined, model, data)
    points = np.concatenate(patches)
    way = np.concatenate([np.tile(way, (len(patch), 1)) for patch, way in zip(patches, ways, strict=True)])
    up = np.array([0.0, 0.0, arch * float(np.linalg.norm(way[:, :2], axis=1).max())])
    start, timestep = cloth.points(imagined.qpos)[points], model.opt.timestep
    steps = max(1, math.ceil(seconds / timestep))
    with led(model, imagined, cloth, points) as lead:
        for step in range(1, steps + 1):
            share = (1 - math.cos(math.pi * step / steps)) / 2
            lead(start + share * way + math.sin(math.pi * share) * up)
    for _ in range(math.ceil(_REST / timestep)):
        mujoco.mj_step(model, imagined)
    columns, rows = cloth.grid
    return cloth.points(imagined.qpos).reshape(rows, columns, 3)
