"""portal's own client on a simulated arm: JSON of the answers. `python portal_arm.py PORT CALLS`."""

from __future__ import annotations

import json
import sys
import time

import numpy as np
import portal

POSE = np.array([0.3, 1.2, 1.2, -0.2, 0.1, 0.2, 1.0])


def main() -> None:
    client = portal.Client(f"127.0.0.1:{sys.argv[1]}", logging=False)
    start = client.get_joint_pos().result()
    for k in range(100):
        client.command_joint_pos(start + (POSE - start) * k / 99).result()
        time.sleep(0.02)
    time.sleep(1.0)
    told = {"dofs": int(client.num_dofs().result()), "pos": client.get_joint_pos().result().tolist()}
    told["observations"] = {key: len(value) for key, value in client.get_observations().result().items()}
    took = []
    for _ in range(int(sys.argv[2])):
        began = time.perf_counter()
        client.get_joint_pos().result()
        took.append(1000 * (time.perf_counter() - began))
    told["p50_ms"], told["p95_ms"] = np.percentile(took, (50, 95)).tolist()
    told["calls_s"] = 1000 / float(np.mean(took))
    try:
        client.command_joint_pos(np.full(7, np.nan)).result()
    except RuntimeError as error:
        told["refused"] = str(error)
    client.command_joint_state({"pos": np.append(POSE[:6], 0.0), "vel": np.zeros(7)}).result()
    time.sleep(2.0)
    told["closed"] = float(client.get_joint_pos().result()[6])
    client.close()
    print(json.dumps(told))


main()
