"""The messages of the real client of /act for pictures, a state and a task: observed.npz, sent.json."""

import json
import sys
from pathlib import Path
from types import SimpleNamespace

import json_numpy
import numpy as np
from inspect_robots_yam.policy import ActServerPolicy

observed, out = np.load(sys.argv[1]), sys.argv[2]
sent = []


def post(url, payload, timeout_s):
    sent.append(json_numpy.dumps(payload))
    return json_numpy.loads(json_numpy.dumps({"actions": np.zeros((30, 14)), "dt_ms": 33.3}))


policy = ActServerPolicy(post_fn=post)
policy.reset(SimpleNamespace(instruction=str(observed["prompt"])))
images = {name: observed[name] for name in ("top_cam", "left_cam", "right_cam")}
chunk = policy.act(SimpleNamespace(images=images, state={"joint_pos": observed["state"]}))
Path(out).write_text(sent[0])
print(json.dumps({"actions": len(chunk.actions), "hz": chunk.control_hz}))
