"""States of a simulation at any moments, whatever its steps are."""

from __future__ import annotations

import mujoco
import numpy as np

from ..geometry.se3 import Array

# Times are sums of steps: so much of rounding is none.
_ROUNDING_S = 1e-9


class Moments:
    """Gathers MuJoCo's positions at given times while a simulation runs: give it to `sim.rollout.simulate` as `see`.

    A moment on a step is that step's state, bit for bit. One between two steps lies on the straight way from one state
    to the other, as joints turn, and bodies turn and move.

    Attributes:
        qpos: positions (n, nq) at the times, as far as the simulation has come.

    Args:
        model: of the simulation.
        times: when (n,), in order, s.
    """

    def __init__(self, model: mujoco.MjModel, times: Array) -> None:
        self._model = model
        self._times = times
        self._next = 0
        self._before = (0.0, np.zeros(model.nq))
        self.qpos = np.full((len(times), model.nq), np.nan)

    def __call__(self, data: mujoco.MjData) -> None:
        """Look at the start, or at the state after a step."""
        while self._next < len(self._times) and self._times[self._next] <= data.time + _ROUNDING_S:
            self.qpos[self._next] = self._at(self._times[self._next], data)
            self._next += 1
        self._before = (data.time, data.qpos.copy())

    def _at(self, time: float, data: mujoco.MjData) -> Array:
        then, qpos = self._before
        if abs(time - data.time) <= _ROUNDING_S:
            there: Array = data.qpos.copy()
            return there
        if abs(time - then) <= _ROUNDING_S:
            return qpos
        way, found = np.zeros(self._model.nv), qpos.copy()
        mujoco.mj_differentiatePos(self._model, way, 1.0, qpos, data.qpos)
        mujoco.mj_integratePos(self._model, found, way, (time - then) / (data.time - then))
        return found
