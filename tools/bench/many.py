"""Environment steps per second and core, and memory per environment, of the vector environment without images.

    python -m tools.bench.many [--task pickplace] [--rig RIG] [--envs 64] [--steps 40] [--hz 20]

Compares the vector environment on one thread with single environments, in alternation, in CPU time, at rest after a
second of settling. `--hz` scales the rates from the environment's control ticks to control at this rate: physics per
simulated second is the same. Prints the parts of a step in MuJoCo's own timers.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np

from yamsim_cli.gym_env import ENV_ID

SETTLING_TICKS = 31  # control ticks, 1 s
ROUNDS = 5  # alternations


def resident_mb() -> float:
    """Return the resident memory of this process, MB."""
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmRSS:")[1].split()[0]) / 1000


def rest(env: Any, observation: dict[str, Any]) -> np.ndarray:
    """Return actions that hold the joints, with the welds off."""
    joints = observation["joints"]
    return np.concatenate([joints, np.zeros((len(joints), env.single_action_space.shape[0] - joints.shape[1]))], axis=1)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--task", default="pickplace")
    parser.add_argument("--rig")
    parser.add_argument("--envs", type=int, default=64)
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--hz", type=float, default=20.0)
    arguments = parser.parse_args()
    options = {"task": arguments.task, "rig": arguments.rig, "max_ticks": 10**6}
    gymnasium.make_vec(ENV_ID, num_envs=2, threads=1, **options).reset(seed=0)
    before = resident_mb()
    many = gymnasium.make_vec(ENV_ID, num_envs=arguments.envs, threads=1, **options)
    single = gymnasium.make_vec(ENV_ID, num_envs=1, vectorization_mode="sync", **options)
    running = {}
    for name, env in (("vector", many), ("single", single)):
        observation, _ = env.reset(seed=0)
        running[name] = (env, actions := rest(env, observation))
        for _ in range(SETTLING_TICKS):
            env.step(actions)
        if name == "vector":
            memory = (resident_mb() - before) / arguments.envs
    vector: Any = many.unwrapped
    trial = vector._trial(0)
    timing, model = trial.simulator.config.task.timing, trial.episode.scene.model
    rates: dict[str, list[float]] = {"vector": [], "single": []}
    physics = []
    data = mujoco.MjData(model)
    for _ in range(ROUNDS):
        for name, (env, actions) in running.items():
            steps = arguments.steps if name == "vector" else arguments.steps * 8
            began = time.process_time()
            for _ in range(steps):
                env.step(actions)
            rates[name].append(steps * len(actions) / (time.process_time() - began))
        mujoco.mj_copyData(data, model, trial.episode.data)
        began = time.process_time()
        mujoco.mj_step(model, data, 2000)
        physics.append((time.process_time() - began) / 2000)
    microseconds = statistics.median(physics) * 1e6
    steps, tick = timing.physics_steps_per_tick, timing.tick_seconds * 1000
    print(f"{arguments.task}: {steps} physics steps in a control tick of {tick:g} ms")
    print(f"{microseconds:.1f} us a physics step; {data.ncon} contacts, {data.nefc} constraints, {model.nv} dof")
    scale = arguments.hz * timing.tick_seconds
    for name, found in rates.items():
        rate = statistics.median(found)
        print(f"{name}: {rate:.0f} env steps per s and core; {rate * scale:.0f} scaled to {arguments.hz:g} Hz")
    bound = 1e6 / (microseconds / (timing.timestep * arguments.hz))
    print(f"physics alone: {bound:.0f} at {arguments.hz:g} Hz; {memory:.2f} MB for each environment")
    parts = {
        kind.name.removeprefix("mjTIMER_").lower(): data.timer[int(kind)]
        for kind in map(mujoco.mjtTimer, range(int(mujoco.mjtTimer.mjNTIMER)))
    }
    print(", ".join(f"{name} {one.duration / one.number * 1e6:.1f} us" for name, one in parts.items() if one.number))


if __name__ == "__main__":
    main()
