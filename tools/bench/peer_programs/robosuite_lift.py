"""Measures robosuite's Lift with a Panda arm; see `tools.bench.peers`. Runs with an interpreter that has robosuite."""

from __future__ import annotations

import importlib
import json
import os
import sys
import time

os.environ.setdefault("MUJOCO_GL", "egl")
# One rendering thread, so that CPU time is that of one core.
os.environ.setdefault("LP_NUM_THREADS", "0")


def main() -> None:
    """Step random actions, and render every camera in each frame; print one line of JSON."""
    asked = json.loads(sys.argv[1])
    robosuite, np = importlib.import_module("robosuite"), importlib.import_module("numpy")
    env = robosuite.make(
        "Lift",
        robots="Panda",
        has_renderer=False,
        has_offscreen_renderer=True,
        use_camera_obs=False,
        control_freq=asked["hz"],
        horizon=10**6,
        ignore_done=True,
    )
    env.reset()
    low, high = env.action_spec
    rng = np.random.default_rng(0)
    cameras = ("agentview", "robot0_eye_in_hand", "frontview")[: asked["cameras"]]
    physics = pictures = 0.0
    warm_up = 3
    for frame in range(asked["frames"] + warm_up):
        began = time.process_time()
        env.step(rng.uniform(low, high))
        stepped = time.process_time()
        for camera in cameras:
            image = env.sim.render(width=asked["width"], height=asked["height"], camera_name=camera)
            if not image.any():
                raise SystemExit(f"camera {camera} renders black images")
        if frame >= warm_up:
            physics += stepped - began
            pictures += time.process_time() - stepped
    mujoco = importlib.import_module("mujoco")
    versions = f"robosuite {robosuite.__version__}, MuJoCo {mujoco.__version__}"
    print(json.dumps({"versions": versions, "physics_s": physics, "pictures_s": pictures}))


if __name__ == "__main__":
    main()
