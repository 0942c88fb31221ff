"""Points of cloth that are led where they are to be, whatever pulls at them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..geometry.se3 import Array
from ..scene.compiled import SceneCloth

# What is led weighs so much, kg. MuJoCo finds how all points move together: a point that weighs a tenth of a gramme
# would come back to the rest of the cloth instead of taking that along, and cloth would stretch tenfold.
_HEAVY = 1.0


@contextmanager
def led(
    model: mujoco.MjModel, data: mujoco.MjData, cloth: SceneCloth, points: NDArray[np.int_]
) -> Iterator[Callable[[Array], None]]:
    """Lead points of a cloth, by their numbers (n,): each call of what is yielded makes a step of physics, after which
    they are where it says (n, 3), in `world`, m.

    Their masses in the model are others meanwhile.
    """
    dof = cloth.dof[points]
    bodies = model.dof_bodyid[dof[:, 0]]
    masses, inertias = model.body_mass[bodies].copy(), model.dof_M0[dof].copy()

    def step(at: Array) -> None:
        qpos = at - cloth.rest[points]
        data.qvel[dof] = (qpos - data.qpos[cloth.qpos[points]]) / model.opt.timestep
        mujoco.mj_step(model, data)
        data.qpos[cloth.qpos[points]] = qpos

    try:
        model.body_mass[bodies], model.dof_M0[dof] = _HEAVY, _HEAVY
        yield step
    finally:
        model.body_mass[bodies], model.dof_M0[dof] = masses, inertias
