from __future__ import annotations

import mujoco
import numpy as np

from ..core.geometry.se3 import Array
from .export_source import ROUNDING_S


class StateSampler:
    """Stores MuJoCo `qpos` at given times while a simulation runs, as the `on_step` callback of `core.episode.Episode`.

    A sample at the time of a step is exact. Between steps, positions are interpolated.

    Attributes:
        qpos: positions (n, nq) at the times; NaN for times that the simulation has not reached.

    Args:
        times: (n,) in ascending order, s.
    """

    def __init__(self, model: mujoco.MjModel, times: Array) -> None:
        self._model = model
        self._times = times
        self._next = 0
        self._before = (0.0, np.zeros(model.nq))
        self.qpos = np.full((len(times), model.nq), np.nan)

    def __call__(self, data: mujoco.MjData) -> None:
        """Store all samples up to the current state."""
        while self._next < len(self._times) and self._times[self._next] <= data.time + ROUNDING_S:
            self.qpos[self._next] = self._qpos_at(self._times[self._next], data)
            self._next += 1
        self._before = (data.time, data.qpos.copy())

    def _qpos_at(self, time: float, data: mujoco.MjData) -> Array:
        then, qpos = self._before
        if abs(time - data.time) <= ROUNDING_S:
            present: Array = data.qpos.copy()
            return present
        if abs(time - then) <= ROUNDING_S:
            return qpos
        velocity, found = np.zeros(self._model.nv), qpos.copy()
        mujoco.mj_differentiatePos(self._model, velocity, 1.0, qpos, data.qpos)
        mujoco.mj_integratePos(self._model, found, velocity, (time - then) / (data.time - then))
        return found
