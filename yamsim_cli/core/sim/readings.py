"""What encoders read of arms: late, with noise, in steps and off by their offsets, where their dynamics say so."""

from __future__ import annotations

import mujoco
import numpy as np

from ..geometry.se3 import Array
from ..scene.compiled import CompiledScene, SceneArm
from ..tasks.randomness import Stream, generator
from ..types import EpisodeJob


def sensed(scene: CompiledScene, data: mujoco.MjData) -> Array | None:
    """Where the joints and fingers (arms, drives) were when what is read now was measured; None where that is now."""
    if all(arm.sensors is None for arm in scene.arms):
        return None
    return np.array([_seen(scene.model, data, arm) for arm in scene.arms])


def readings(scene: CompiledScene, positions: Array, job: EpisodeJob, tick: int) -> Array:
    """What is read (arms, drives) where joints and fingers are so, rad and m.

    Args:
        positions: of the joints and the left finger (arms, drives), see `sensed`.
        tick: of control; noise follows from the attempt and this number, and so is the same whoever asks.
    """
    if all(arm.reads_exactly for arm in scene.arms):
        return positions
    read = positions.copy()
    for k, arm in enumerate(scene.arms):
        if arm.reads_exactly:
            continue
        joints = read[k, : arm.dof] + arm.offset
        if arm.sensor_noise:
            rng = generator(job, Stream.READINGS, tick, k)
            joints = joints + rng.normal(0.0, arm.sensor_noise, arm.dof)
        if step := arm.encoder_step:
            joints = np.round(joints / step) * step
        read[k, : arm.dof] = joints
    return read


def _seen(model: mujoco.MjModel, data: mujoco.MjData, arm: SceneArm) -> Array:
    now: Array = data.qpos[arm.recorded_qpos]
    if arm.sensors is None:
        return now
    kept = np.array([_read(model, data, int(sensor)) for sensor in arm.sensors])
    # The newest that a sensor keeps is from the step before; what is newer lies between that and now.
    share = min(arm.sensor_delay / model.opt.timestep, 1.0)
    return kept if share == 1.0 else now + share * (kept - now)


def _read(model: mujoco.MjModel, data: mujoco.MjData, sensor: int) -> float:
    """Where a joint was, as long ago as its sensor needs."""
    between, result = int(model.sensor_history[sensor, 1]), np.empty((1, 1))
    return float(mujoco.mj_readSensor(model, data, sensor, data.time, result, between).ravel()[0])
