"""Scenes of a rig alone, and motions made in them, for tests of recorded commands."""

from __future__ import annotations

import os
from dataclasses import replace
from functools import cache

import mujoco
import numpy as np

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.recorded_motion import ArmMotion, RecordedMotion
from yamsim_cli.core.scene.build import build_rig_scene
from yamsim_cli.core.scene.compiled import CompiledScene

STEP = 0.002


@cache
def rig_scene(name: str = "single", timestep: float = STEP) -> CompiledScene:
    return new_scene(name, timestep)


def new_scene(name: str = "single", timestep: float = STEP) -> CompiledScene:
    """A new scene, whose model may be changed."""
    where = Locations.from_environment(os.environ)
    rig = load_config(RigConfig, "rigs", name, where)
    return build_rig_scene(rig, load_config(SceneConfig, "scenes", "studio", where), where, timestep)


def swings(times: Array, still: float = 0.5, amplitude: float = 0.3, seed: int = 0) -> Array:
    """Commands (n, 6) that hold still at first, then swing every joint at its own rate, and hold still at last."""
    rng = np.random.default_rng(seed)
    home = np.array([0.0, 1.4, 1.5, -0.3, 0.0, 0.0])
    begin, end = still, times[-1] - still
    inside = np.clip((times - begin) / (end - begin), 0, 1)[:, None]
    pace = rng.uniform(1.0, 3.0, 6) * (end - begin) / 4
    return home + amplitude * np.sin(np.pi * inside) ** 2 * np.sin(2 * np.pi * pace * inside)


def plant(
    scene: CompiledScene, times: Array, commands: list[Array], openings: float = 0.02, gravity: float = 1.0
) -> RecordedMotion:
    """Motion by MuJoCo's own loop with commands of each arm (n, dof) at times that are whole numbers of steps.

    Args:
        gravity: multiple of the weight that the drives compensate.
    """
    data = mujoco.MjData(scene.model)
    qpos = scene.model.qpos0.copy()
    for arm, rows in zip(scene.arms, commands, strict=True):
        qpos[arm.joint_qpos] = rows[0]
        if arm.fingers is not None:
            qpos[arm.fingers.qpos] = openings * arm.fingers.sign
    scene.reset(data, qpos)
    joints = [np.empty_like(rows) for rows in commands]
    opened = [np.zeros(len(times)) for _ in commands]
    for k, time in enumerate(times):
        while data.time < time - scene.model.opt.timestep / 2:
            data.qfrc_applied[:] = (gravity - 1) * data.qfrc_gravcomp
            mujoco.mj_step(scene.model, data)
        for arm, rows, seen, fingers in zip(scene.arms, commands, joints, opened, strict=True):
            data.ctrl[arm.arm_ctrl] = rows[k]
            seen[k] = data.qpos[arm.joint_qpos]
            if arm.fingers is not None:
                fingers[k] = data.qpos[arm.fingers.qpos[0]] * arm.fingers.sign[0]
    sides = ("",) if len(commands) == 1 else ("left", "right")
    told = np.full(len(times), openings)
    arms = [
        ArmMotion(side, seen, rows, openings=fingers, commanded_openings=told)
        for side, seen, rows, fingers in zip(sides, joints, commands, opened, strict=True)
    ]
    return RecordedMotion("plant", times, tuple(arms))


def later(motion: RecordedMotion, samples: int) -> RecordedMotion:
    """The same motion measured `samples` later; its commands stay."""
    arms = tuple(
        replace(
            arm, joints=np.vstack([np.repeat(arm.joints[:1], samples, axis=0), arm.joints[: len(arm.joints) - samples]])
        )
        for arm in motion.arms
    )
    return replace(motion, arms=arms)
