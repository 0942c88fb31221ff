"""Measures a task of yamsim, as `yamsim record` simulates and renders it; see `tools.bench.peers`."""

from __future__ import annotations

import json
import os
import sys
import time

os.environ.setdefault("MUJOCO_GL", "egl")
# One rendering thread, so that CPU time is that of one core.
os.environ.setdefault("LP_NUM_THREADS", "0")

import mujoco

from yamsim_cli import __version__
from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.episode.attempt_payload import render_cameras
from yamsim_cli.core.episode.execution import simulate_expert
from yamsim_cli.core.episode.sampling import sample_attempt
from yamsim_cli.core.episode.simulator import make_simulator
from yamsim_cli.session_opener import SessionOpener


def main() -> None:
    """Simulate the expert, and render every camera in consecutive frames; print one line of JSON."""
    asked = json.loads(sys.argv[1])
    opener = SessionOpener(os.environ, lambda text: None, lambda name: name)
    size = f"{asked['width']}x{asked['height']}"
    session = opener.open("default", task=asked["task"], size=size, quality=asked["quality"], wrist=True)
    with make_simulator(session, job := AttemptJob(0, 0)) as simulator:
        # The first attempt warms up.
        for _ in range(2):
            began = time.process_time()
            done = simulate_expert(simulator, sample_attempt(simulator, job))
            physics = time.process_time() - began
        states, cameras = done.recorded_states, simulator.scene.cameras[: asked["cameras"]]
        if len(cameras) < asked["cameras"]:
            raise SystemExit(f"{asked['task']} has only {len(cameras)} cameras")
        # From the middle, where the arm moves.
        warm_up, number_of_frames = 3, min(asked["frames"], len(states) - 3)
        first = (len(states) - number_of_frames - warm_up) // 2
        for number, state in enumerate(states[first : first + number_of_frames + warm_up]):
            if number == warm_up:
                began = time.process_time()
            render_cameras(simulator, done.attempt, state.qpos, cameras)
        pictures = (time.process_time() - began) * asked["frames"] / number_of_frames
    share = asked["frames"] / len(states)
    versions = f"yamsim {__version__}, MuJoCo {mujoco.__version__}"
    print(json.dumps({"versions": versions, "physics_s": physics * share, "pictures_s": pictures}))


if __name__ == "__main__":
    main()
