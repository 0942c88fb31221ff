"""Readings of arms' encoders, with the delay, noise, resolution and offset of the arms' dynamics."""

from __future__ import annotations

import mujoco
import numpy as np

from ..attempt_data import AttemptJob
from ..geometry.se3 import Array
from ..scene.compiled import ArmAddresses, CompiledScene
from ..scene.random_streams import Stream, random_generator


def delayed_positions(scene: CompiledScene, data: mujoco.MjData) -> Array | None:
    """Delayed positions (arms, drives) of joints and fingers, rad and m; None if no encoder has a delay."""
    if all(arm.sensors is None for arm in scene.arms):
        return None
    return np.array([_delayed_arm_positions(scene.model, data, arm) for arm in scene.arms])


def encoder_readings(scene: CompiledScene, positions: Array, job: AttemptJob, tick: int) -> Array:
    """Readings (arms, drives) of encoders at given positions, rad and m.

    Args:
        positions: of the joints and the left finger (arms, drives), see `sensed`.
        tick: number of the control tick; the same attempt and tick give the same noise.
    """
    if all(arm.has_ideal_encoders for arm in scene.arms):
        return positions
    read = positions.copy()
    for k, arm in enumerate(scene.arms):
        if arm.has_ideal_encoders:
            continue
        joints = read[k, : arm.dof] + arm.offset
        if arm.sensor_noise:
            rng = random_generator(job, Stream.READINGS, tick, k)
            joints = joints + rng.normal(0.0, arm.sensor_noise, arm.dof)
        if step := arm.encoder_step:
            joints = np.round(joints / step) * step
        read[k, : arm.dof] = joints
    return read


def _delayed_arm_positions(model: mujoco.MjModel, data: mujoco.MjData, arm: ArmAddresses) -> Array:
    now: Array = data.qpos[arm.recorded_qpos]
    if arm.sensors is None:
        return now
    kept = np.array([_read(model, data, int(sensor)) for sensor in arm.sensors])
    # The newest kept value is from the step before; a shorter delay is interpolated between that and the present.
    share = min(arm.sensor_delay / model.opt.timestep, 1.0)
    return kept if share == 1.0 else now + share * (kept - now)


def _read(model: mujoco.MjModel, data: mujoco.MjData, sensor: int) -> float:
    """A joint's position, as delayed as its sensor reads it."""
    between, result = int(model.sensor_history[sensor, 1]), np.empty((1, 1))
    return float(mujoco.mj_readSensor(model, data, sensor, data.time, result, between).ravel()[0])
