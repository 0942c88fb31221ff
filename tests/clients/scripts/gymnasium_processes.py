"""Environments with images in processes of their own, for each way in which gymnasium starts processes."""

from __future__ import annotations

import json
import time

import gymnasium

import yamsim_cli.gym_env
from yamsim_cli.core.errors import ResourceError

OPTIONS = {"observation": "images", "size": (64, 48)}


def contrast(context: str) -> float:
    """The spread of the scene cameras' first picture's values."""
    envs = gymnasium.make_vec(
        yamsim_cli.gym_env.ENV_ID,
        num_envs=2,
        vectorization_mode="async",
        vector_kwargs={"context": context},
        **OPTIONS,
    )
    try:
        observation, _ = envs.reset(seed=3)
        envs.step(envs.action_space.sample())
        return float(observation["scene_rgb"].std())
    finally:
        envs.close()


def main() -> None:
    told = {"fork": contrast("fork")}
    env = gymnasium.make(yamsim_cli.gym_env.ENV_ID, **OPTIONS)
    env.reset(seed=3)
    begun = time.monotonic()
    try:
        contrast("fork")
    except ResourceError as error:
        told["refused"] = str(error)
    told["seconds"] = time.monotonic() - begun
    told["forkserver"] = contrast("forkserver")
    env.close()
    print(json.dumps(told))


if __name__ == "__main__":
    main()
