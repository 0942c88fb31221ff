"""Errors of `yamsim gap` for plants with known differences to the model, and its cost.

    python -m tools.bench.gap [--plants N]

Plants step by 0.5 ms, and the model by 2 ms. Commands come at jittered times, and joints are measured with the
resolution of the manufacturer's CAN messages.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass

import mujoco
import numpy as np

from tests.rig_scenes import STEP, new_scene, plant, rig_scene, swings
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.recorded_motion import ArmMotion, RecordedMotion
from yamsim_cli.core.scene.compiled import CompiledScene
from yamsim_cli.real.gap.gap_figures import measure_gap

_FINE = 0.0005
# rad, 16 bits over 25 rad. Source: `motor_drivers/utils.py` in the manufacturer's SDK 1.3.6.
_CAN_STEP = 25 / 65536
_SECONDS = 15.0


@dataclass(frozen=True)
class TruePlantDifference:
    """Difference of a plant: delay of its commands, s, and friction factor of each joint."""

    delay: float
    friction: Array


def jittered(rng: np.random.Generator) -> Array:
    """Times of samples, 8 to 12 ms apart, s."""
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.008, 0.012, round(_SECONDS / 0.01)))])
    return np.round(times, 6)


def real(scene: CompiledScene, times: Array, commands: Array, planted: TruePlantDifference) -> RecordedMotion:
    """Return the measurements of a plant with commands (n, dof)."""
    arm, data = scene.first_arm, mujoco.MjData(scene.model)
    own = scene.model.dof_frictionloss[arm.joint_dof].copy()
    scene.model.dof_frictionloss[arm.joint_dof] = own * planted.friction
    qpos = scene.model.qpos0.copy()
    qpos[arm.joint_qpos] = commands[0]
    scene.reset(data, qpos)
    joints = np.empty_like(commands)
    for k, moment in enumerate(times):
        while data.time < moment - _FINE / 2:
            told = int(np.searchsorted(times, data.time - planted.delay, side="right")) - 1
            data.ctrl[arm.arm_ctrl] = commands[max(0, told)]
            mujoco.mj_step(scene.model, data)
        joints[k] = data.qpos[arm.joint_qpos]
    scene.model.dof_frictionloss[arm.joint_dof] = own
    return RecordedMotion("plant", times, (ArmMotion("", np.round(joints / _CAN_STEP) * _CAN_STEP, commands),))


def delays(plants: int, frictions: tuple[float, float]) -> dict[str, float]:
    """Errors of planted delays of 0 to 60 ms, ms, over all joints of all plants."""
    fine, model = new_scene("single", _FINE), rig_scene()
    off, sizes = [], []
    for seed in range(plants):
        rng = np.random.default_rng([11, seed])
        times = jittered(rng)
        planted = TruePlantDifference(rng.uniform(0, 0.06), rng.uniform(*frictions, 6))
        gap = measure_gap(model, real(fine, times, swings(times, seed=seed), planted))
        off += [
            1000 * (joint.measured_vs_simulated.delay - planted.delay)
            for joint in gap.joints
            if joint.measured_vs_simulated.delay is not None
        ]
        sizes.append(gap.error.rms * 1000)
    spread = np.percentile(np.abs(off), [50, 95, 100])
    return {
        "plants": plants,
        "found": len(off),
        "bias_ms": float(np.mean(off)),
        **dict(zip(("median_ms", "p95_ms", "max_ms"), map(float, spread), strict=True)),
        "gap_mrad": float(np.median(sizes)),
    }


def perfect(plants: int) -> float:
    """Largest error for the model's own motions, at times that jitter by whole steps, mrad."""
    worst = 0.0
    for seed in range(plants):
        steps = np.random.default_rng([12, seed]).integers(3, 8, round(_SECONDS / 0.01))
        times = np.round(np.concatenate([[0], np.cumsum(steps)]) * STEP, 6)
        worst = max(worst, measure_gap(rig_scene(), plant(rig_scene(), times, [swings(times, seed=seed)])).error.max)
    return worst * 1000


def cost() -> float:
    """Return seconds for a minute of one arm at 100 Hz."""
    times = np.arange(0, 60, 0.01)
    motion = plant(rig_scene(), times, [swings(times)])
    began = time.perf_counter()
    measure_gap(rig_scene(), motion)
    return time.perf_counter() - began


def main() -> None:
    """Measure, and print JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--plants", type=int, default=20)
    plants = parser.parse_args().plants
    figures = {
        "perfect_max_mrad": perfect(plants),
        "delay_alone": delays(plants, (1.0, 1.0)),
        "delay_and_friction": delays(plants, (0.7, 1.5)),
        "seconds_a_minute": cost(),
    }
    print(json.dumps(figures, indent=2))


if __name__ == "__main__":
    main()
