"""Bases in the collision checker of inspect-robots-yam, from a config.ini: `read_bases.py CONFIG`."""

from __future__ import annotations

import json
import sys

import mujoco
from inspect_robots.defaults import load_defaults
from inspect_robots_yam.collision import CollisionChecker, _config_from_yam
from inspect_robots_yam.config import YamConfig

defaults = load_defaults({"INSPECT_ROBOTS_CONFIG": sys.argv[1]})
checker = CollisionChecker(_config_from_yam(YamConfig.from_kwargs(**defaults.embodiment_args)))
model = checker._model
data = mujoco.MjData(model)
mujoco.mj_kinematics(model, data)
found = {}
for side in ("left", "right"):
    # The arm's first body is the base, which the checker places.
    joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, f"{side}_joint1")
    base = model.body_rootid[model.jnt_bodyid[joint]]
    found[side] = {"position": data.xpos[base].tolist(), "rotation": data.xmat[base].reshape(3, 3).tolist()}
print(json.dumps(found | {"keys": sorted(defaults.embodiment_args)}))
