from __future__ import annotations

import mujoco
import numpy as np

from ..attempt_data import AttemptJob
from ..geometry.se3 import Array
from ..scene.compiled import ArmAddresses, CompiledScene
from ..scene.random_streams import Stream, random_generator


def delayed_positions(scene: CompiledScene, data: mujoco.MjData) -> Array | None:
    """Return the delayed positions (arms, drives) of joints and left fingers, rad and m; None if no arm has a delay."""
    if all(arm.sensors is None for arm in scene.arms):
        return None
    return np.array([_delayed_arm_positions(scene.model, data, arm) for arm in scene.arms])


def encoder_readings(scene: CompiledScene, positions: Array, job: AttemptJob, tick: int) -> Array:
    """Add offset, noise and resolution to delayed positions (arms, drives) of joints and left fingers, rad and m.

    The noise depends only on the attempt, the control `tick` and the arm.
    """
    if all(arm.has_ideal_encoders for arm in scene.arms):
        return positions
    read = positions.copy()
    for k, arm in enumerate(scene.arms):
        if arm.has_ideal_encoders:
            continue
        joints = read[k, : arm.dof] + arm.encoder_offset
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
    delayed = np.array([_read_delayed_sensor(model, data, int(sensor)) for sensor in arm.sensors])
    # The newest sample of a sensor is one step old. For a shorter delay, interpolate from there to the present.
    share = min(arm.sensor_delay / model.opt.timestep, 1.0)
    return delayed if share == 1.0 else now + share * (delayed - now)


def _read_delayed_sensor(model: mujoco.MjModel, data: mujoco.MjData, sensor: int) -> float:
    between, result = int(model.sensor_history[sensor, 1]), np.empty((1, 1))
    return float(mujoco.mj_readSensor(model, data, sensor, data.time, result, between).ravel()[0])
