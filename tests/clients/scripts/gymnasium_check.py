"""Run gymnasium's checker on the environment; it raises for a fault."""

from __future__ import annotations

import json
import warnings

import gymnasium
from gymnasium.utils.env_checker import check_env

import yamsim_cli.gym_env

for options in ({}, {"observation": "images", "render_mode": "rgb_array", "size": (64, 48)}):
    env = gymnasium.make(yamsim_cli.gym_env.ENV_ID, **options)
    with warnings.catch_warnings():
        # Joints have their own bounds, and not -1..1.
        warnings.filterwarnings("ignore", message=".*(Box action space|normalized).*")
        check_env(env.unwrapped)
    env.close()
print(json.dumps({"version": gymnasium.__version__}))
