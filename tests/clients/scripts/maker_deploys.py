"""The maker's policy client with real-time chunking: `maker_deploys.py CHECKOUT PORT STEPS`.

Its state is the number of the step, so that the server knows when it was asked.
"""

from __future__ import annotations

import json
import sys
import time

import numpy as np


def main(checkout: str, port: str, steps: str) -> None:
    sys.path.insert(0, checkout)
    from yam_abc_reproduce.deploy.client import WebsocketPolicyClient

    client = WebsocketPolicyClient("127.0.0.1", int(port), rtc=True)
    images = {role: np.full((48, 64, 3), 7, np.uint8) for role in ("top", "left", "right")}
    rows = []
    for k in range(int(steps)):
        observed = {"images": images, "state": np.full(14, k, np.float32), "prompt": "do it"}
        rows.append(client.get_action(observed).tolist())
        time.sleep(0.05)  # the server answers at once, long before the plan is over
    client.reset()
    print(json.dumps({"rows": rows}))


if __name__ == "__main__":
    main(*sys.argv[1:])
