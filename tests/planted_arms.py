"""Arms with known parameters in a physics of their own, and their logs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from yamsim_cli.core.config.rig import ArmConfig
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.recorded_motion import ArmMotion, RecordedMotion
from yamsim_cli.core.scene.arm_model import arm_spec

# rad, CAN message of a motor: 16 bits for +-12.5 rad. Source: POSITION_MAX of DM4310 and DM4340 in the manufacturer's
# SDK 1.3.6.
ENCODER_STEP = 25 / 65535
_STEP = 0.0005


@dataclass(frozen=True)
class TrueParameters:
    """Parameters of an arm. All but the delay are per joint (dof,); units as in `identify.plant.Values`.

    Attributes:
        law: of friction: `tanh`, `stribeck` or `coulomb`.
        integrator: of MuJoCo.
    """

    delay: float
    friction: Array
    damping: Array
    armature: Array
    offset: Array
    gravity: Array
    law: str
    integrator: str


def random_plant(arm: ArmConfig, rng: np.random.Generator) -> TrueParameters:
    """A random arm that differs from its model in all fitted parameters."""
    spec = arm_spec(arm, None).compile()
    joints = [spec.joint(name) for name in arm.robot.joint_names]
    dof = np.array([joint.dofadr[0] for joint in joints])
    drives = np.array([spec.actuator(name).id for name in arm.robot.joint_drives])
    kv, friction, armature = -spec.actuator_biasprm[drives, 2], spec.dof_frictionloss[dof], spec.dof_armature[dof]
    n = len(dof)
    return TrueParameters(
        delay=float(rng.uniform(0.008, 0.045)),
        friction=friction * rng.uniform(0.6, 2.0, n),
        damping=kv * rng.uniform(0.1, 0.6, n),
        armature=armature * rng.uniform(0.6, 2.0, n),
        offset=rng.uniform(-0.02, 0.02, n),
        gravity=rng.uniform(0.9, 1.1, n),
        law=str(rng.choice(["tanh", "stribeck"])),
        integrator=str(rng.choice(["EULER", "RK4"])),
    )


# Friction law -> rad/s, speed at which friction is nearly full.
_SETS_IN = {"tanh": 0.02, "stribeck": 0.02, "coulomb": 0.005}


def _friction(planted: TrueParameters, invweight: Array) -> Callable[[Array], Array]:
    """Friction torques (dof,), N m, at speeds (dof,), rad/s, in the middle of a step.

    Args:
        invweight: acceleration of a joint per torque (dof,), 1/(kg m2).
    """
    slow = _SETS_IN[planted.law]

    def law(speed: Array) -> Array:
        bump = 0.15 * np.exp(-((speed / 0.05) ** 2)) if planted.law == "stribeck" else 0.0
        found: Array = planted.friction * (1 + bump) * np.tanh(speed / slow)
        return found

    def at(speed: Array) -> Array:
        # Near zero speed friction is stiff: an explicit step would overshoot.
        stiff = planted.friction / slow / np.cosh(np.clip(speed / slow, -20, 20)) ** 2
        found: Array = law(speed) / (1 + stiff * invweight * _STEP / 2)
        return found

    return at


def drive(
    arm: ArmConfig,
    planted: TrueParameters,
    times: Array,
    commands: Array,
    rng: np.random.Generator,
    jitter: float = 0.001,
    step: float = ENCODER_STEP,
    opening: float = 0.0,
) -> RecordedMotion:
    """Return the log of an arm with commands (n, dof) at times (n,).

    Args:
        jitter: largest deviation of a sample's time, s.
        step: of the encoders, rad.
        opening: constant command to the gripper, m of one finger.
    """
    times = times + np.concatenate([[0.0], rng.uniform(-jitter, jitter, len(times) - 1)])
    # Samples lie on the steps of this physics, so that their times are exact.
    times = np.round(times / _STEP) * _STEP
    spec = arm_spec(arm, None)
    spec.option.timestep = _STEP
    spec.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{planted.integrator}")
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    model = spec.compile()
    data = mujoco.MjData(model)
    joints = [model.joint(name) for name in arm.robot.joint_names]
    dof, qpos = (np.array([getattr(joint, key)[0] for joint in joints]) for key in ("dofadr", "qposadr"))
    drives = np.array([model.actuator(name).id for name in arm.robot.joint_drives])
    model.dof_frictionloss[dof] = 0.0
    model.dof_damping[dof] = planted.damping
    model.dof_armature[dof] = planted.armature
    mujoco.mj_setConst(model, data)
    friction = _friction(planted, model.dof_invweight0[dof])
    mujoco.mj_resetData(model, data)
    data.qpos[qpos] = commands[0]
    if (fingers := arm.robot.fingers) is not None:
        places = [model.joint(name).qposadr[0] for name in fingers.joints]
        data.qpos[places] = opening * np.array(arm.robot.finger_signs)
        data.ctrl[model.actuator(fingers.drive).id] = opening
    mujoco.mj_forward(model, data)
    read, next_sample = np.empty(commands.shape), 0
    acting = 0
    for k in range(int(np.ceil(times[-1] / _STEP)) + 1):
        now = k * _STEP
        if next_sample < len(times) and now >= times[next_sample] - _STEP / 2:
            shown = data.qpos[qpos] + planted.offset
            read[next_sample] = np.round(shown / step) * step if step else shown
            next_sample += 1
        while acting + 1 < len(times) and times[acting + 1] <= now - planted.delay + _STEP / 2:
            acting += 1
        data.ctrl[drives] = commands[acting]
        data.qfrc_applied[dof] = (planted.gravity - 1) * data.qfrc_gravcomp[dof] - friction(data.qvel[dof])
        mujoco.mj_step(model, data)
    while next_sample < len(times):
        read[next_sample] = read[next_sample - 1]
        next_sample += 1
    openings = None if arm.robot.fingers is None else np.full(len(times), opening)
    return RecordedMotion("planted", times, (ArmMotion("", read, commands, openings, openings),))
