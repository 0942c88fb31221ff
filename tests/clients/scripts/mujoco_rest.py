"""Plain MuJoCo: how far each composed scene moves in 500 steps from its keyframe, m and rad."""

import json
import sys

import mujoco
import numpy as np

found = {}
for path in sys.argv[1:]:
    model = mujoco.MjModel.from_xml_path(path)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    start = data.qpos.copy()
    for _ in range(500):
        mujoco.mj_step(model, data)
    assert np.isfinite(data.qpos).all(), path
    found[path] = {"nq": model.nq, "nu": model.nu, "moved": float(np.abs(data.qpos - start).max())}
print(json.dumps({"scenes": found}))
