"""chiral's own client on a served robot: `drive_chiral.py CHECKOUT PORT`. It drives a path of joints and observes."""

from __future__ import annotations

import json
import sys
import time
from typing import Any

sys.path.insert(0, sys.argv[1])

import numpy as np
from chiral import PolicyClient

SIDES = ("left", "right")
# Actions a second, as raiden's robot takes.
HZ = 9.0


def joints(seen: Any) -> np.ndarray:
    return np.concatenate([seen.proprios[f"follower_{side[0]}_joint_pos"] for side in SIDES])


def part(seen: Any, name: str) -> np.ndarray:
    return np.concatenate([seen.proprios[f"robot__actual__poses__{side}::yam__{name}"] for side in SIDES])


def play(env: PolicyClient, actions: list[np.ndarray]) -> Any:
    env.start_obs_stream(hz=10)
    env.start_action_dispatch(hz=HZ)
    for action in actions:
        env.put_action(action)
    time.sleep(len(actions) / HZ + 1.5)
    env.stop_action_dispatch()
    env.stop_obs_stream()
    return env.get_obs()


with PolicyClient(f"ws://127.0.0.1:{sys.argv[2]}") as env:
    told = env.get_metadata()
    seen, info = env.reset()
    home = joints(seen)
    start = time.perf_counter()
    waits = []
    for _ in range(60):
        began = time.perf_counter()
        env.get_obs()
        waits.append(time.perf_counter() - began)
    rate = len(waits) / (time.perf_counter() - start)
    goal = home.copy()
    goal[[1, 2, 8, 9]] += 0.6
    goal[6] = 0.4
    path = [home + (goal - home) * share for share in np.linspace(0.1, 1, 10)]
    after = play(env, [*path, goal, goal])
    xyz, rows = part(after, "xyz"), part(after, "rot_6d")
    up = xyz + np.tile([0, 0, 0.03], 2)
    poses = [np.concatenate([xyz + (up - xyz) * share, rows, goal[[6, 13]]]) for share in (0.25, 0.5, 0.75, 1, 1)]
    last = play(env, poses)

print(
    json.dumps(
        {
            "metadata": told,
            "info": info,
            "cameras": {
                one.name: [list(one.image.shape), str(one.image.dtype), float(one.image.std())] for one in last.cameras
            },
            "moved": {
                one.name: float(np.abs(one.image.astype(int) - seen[one.name].image).mean()) for one in last.cameras
            },
            "off_rad": float(np.abs(joints(after) - goal).max()),
            "off_m": float(np.abs(part(last, "xyz") - up).max()),
            "stopped": last.extra["stopped"],
            "age_s": time.time() - last.timestamp,
            "a_second": rate,
            "median_ms": float(np.median(waits) * 1000),
            "p95_ms": float(np.percentile(waits, 95) * 1000),
        }
    )
)
