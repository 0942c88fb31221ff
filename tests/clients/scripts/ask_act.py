"""The answer of yamsim's client for a checkpoint and an observation: folder, observed.npz, actions.npy."""

import json
import os
import sys

import numpy as np

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.policy import PolicyConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.policies.lerobot import LeRobotClient

folder, observed, out = sys.argv[1:]
told = np.load(observed)
client = LeRobotClient(
    folder, load_config(PolicyConfig, "policies", "lerobot_export", Locations.from_environment(os.environ))
)
client.begin_trial(0)
message = {"observation.state": told["state"], "observation.images.scene_camera": told["scene"], "task": "a task"}
np.save(out, client.infer(message)["action"])
print(json.dumps({"asks": client.input_keys, "execute": client.execute}))
