"""Measures gym-aloha's TransferCube; see `tools.bench.peers`. Runs with an interpreter that has gym-aloha."""

from __future__ import annotations

import importlib
import importlib.metadata
import json
import os
import sys
import time

os.environ.setdefault("MUJOCO_GL", "egl")
# One rendering thread, so that CPU time is that of one core.
os.environ.setdefault("LP_NUM_THREADS", "0")

_CONTROL_HZ = 50.0  # Hz, of gym-aloha's steps


def main() -> None:
    """Step random actions, and render every camera in each frame; print one line of JSON."""
    asked = json.loads(sys.argv[1])
    gymnasium, np = importlib.import_module("gymnasium"), importlib.import_module("numpy")
    importlib.import_module("gym_aloha")
    env = gymnasium.make("gym_aloha/AlohaTransferCube-v0", obs_type="pixels", max_episode_steps=10**6).unwrapped
    env.reset(seed=0)
    # A step of the environment renders three images of 640x480 at 50 Hz, so step its task and its physics apart.
    simulation = env._env
    task, physics_of_env, substeps = simulation.task, simulation.physics, simulation._n_sub_steps
    start = np.array([0, -0.96, 1.16, 0, -0.3, 0, 0.02])
    rng = np.random.default_rng(0)
    cameras = ("top", "left_wrist", "right_wrist")[: asked["cameras"]]
    physics = pictures = passed = 0.0
    warm_up = 3
    for frame in range(asked["frames"] + warm_up):
        began = time.process_time()
        while passed < (frame + 1) / asked["hz"]:
            # Both arms move around their start posture: six joints, rad, and the gripper, 0..1.
            task.before_step(np.tile(start, 2) + rng.uniform(-0.05, 0.05, 14), physics_of_env)
            physics_of_env.step(substeps)
            task.after_step(physics_of_env)
            passed += 1 / _CONTROL_HZ
        stepped = time.process_time()
        for camera in cameras:
            image = physics_of_env.render(height=asked["height"], width=asked["width"], camera_id=camera)
            if not image.any():
                raise SystemExit(f"camera {camera} renders black images")
        if frame >= warm_up:
            physics += stepped - began
            pictures += time.process_time() - stepped
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in ("gym-aloha", "mujoco"))
    print(json.dumps({"versions": versions, "physics_s": physics, "pictures_s": pictures}))


if __name__ == "__main__":
    main()
