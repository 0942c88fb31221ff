"""What encoders read of arms: late, with noise, in steps and off by their offsets, where their dynamics say so."""

from __future__ import annotations

import mujoco
import numpy as np

from ..geometry.se3 import Array
from ..scene.compiled import CompiledScene
from ..tasks.randomness import Stream, generator
from ..types import EpisodeJob


def sensed(scene: CompiledScene, data: mujoco.MjData) -> Array | None:
    """Where the joints and fingers (arms, drives) were when what is read now was measured; None where that is now."""
    if all(arm.sensors is None for arm in scene.arms):
        return None
    return np.array(
        [
            data.qpos[arm.recorded_qpos]
            if arm.sensors is None
            else [_read(scene.model, data, int(sensor)) for sensor in arm.sensors]
            for arm in scene.arms
        ]
    )


def readings(scene: CompiledScene, positions: Array, job: EpisodeJob, tick: int) -> Array:
    """What is read (arms, drives) where joints and fingers are so, rad and m.

    Args:
        positions: of the joints and the left finger (arms, drives), see `sensed`.
        tick: of control; noise follows from the attempt and this number, and so is the same whoever asks.
    """
    if all(arm.dynamics is None for arm in scene.arms):
        return positions
    read = positions.copy()
    for k, arm in enumerate(scene.arms):
        if arm.dynamics is None:
            continue
        joints = read[k, : arm.dof] + arm.offset
        if arm.dynamics.sensor_noise_rad:
            rng = generator(job, Stream.READINGS, tick, k)
            joints = joints + rng.normal(0.0, arm.dynamics.sensor_noise_rad, arm.dof)
        if step := arm.dynamics.encoder_step_rad:
            joints = np.round(joints / step) * step
        read[k, : arm.dof] = joints
    return read


def _read(model: mujoco.MjModel, data: mujoco.MjData, sensor: int) -> float:
    """Where a joint was, as long ago as its sensor needs."""
    between, result = int(model.sensor_history[sensor, 1]), np.empty((1, 1))
    return float(mujoco.mj_readSensor(model, data, sensor, data.time, result, between).ravel()[0])
