"""A PPO of Stable-Baselines3 learns to reach the object of `pickplace`, in the vector environment.

    ENV/bin/python -m tools.bench.ppo_reach [--minutes 5] [--envs 64] [--out out/ppo]

ENV has yamsim[gym] and stable-baselines3. Writes `ppo_reach.json` to --out. The actions of the
policy are changes of the joints, at most STEP in a control tick.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

import yamsim_cli.gym_env

STEP = 0.12  # rad, largest difference between a commanded and the present joint position
TICKS = 64  # control ticks of an episode, 2 s


class ReachingArms(VecEnv):
    """The vector environment as Stable-Baselines3's `VecEnv`, with flat observations and joint changes as actions."""

    def __init__(self, count: int, seed: int) -> None:
        self.envs = gymnasium.make_vec(
            yamsim_cli.gym_env.ENV_ID, num_envs=count, reach="object", max_ticks=TICKS, autoreset_mode="SameStep"
        )
        self._seen: dict[str, NDArray[Any]] = {}
        self._first_seed = seed
        self.distances: list[float] = []  # m, at the end of each episode
        seen = gymnasium.spaces.Box(-np.inf, np.inf, (7 + 3 + 3,), np.float32)
        super().__init__(count, seen, gymnasium.spaces.Box(-1.0, 1.0, (6,), np.float32))

    def reset(self) -> NDArray[np.float32]:
        """Start all episodes."""
        self._seen, _ = self.envs.reset(seed=self._first_seed)
        return self._flat(self._seen)

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Keep the commands of the next step; the finger stays open, and the weld off."""
        joints = self._seen["joints"].copy()
        joints[:, :6] += STEP * np.clip(actions, -1.0, 1.0)
        self._actions = np.concatenate([joints, np.zeros((self.num_envs, 1), np.float32)], axis=1)

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Step all environments."""
        self._seen, rewards, terminated, truncated, infos = self.envs.step(self._actions)
        done = terminated | truncated
        told: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for k in np.flatnonzero(done):
            last = {key: value[None] for key, value in infos["final_obs"][k].items()}
            told[k] = {"terminal_observation": self._flat(last)[0], "TimeLimit.truncated": bool(truncated[k])}
            self.distances.append(float(infos["final_info"]["reach"][k]))
        return self._flat(self._seen), rewards.astype(np.float32), done, told

    @staticmethod
    def _flat(seen: dict[str, NDArray[Any]]) -> NDArray[np.float32]:
        hand, item = seen["ee_pose_world"][:, :3, 3], seen["object_pose_world"][:, :3, 3]
        return np.concatenate([seen["joints"], 5.0 * (item - hand), item], axis=1).astype(np.float32)

    def close(self) -> None:
        """Close the environments."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of this object for each environment."""
        return [getattr(self, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse: the environments share their attributes."""
        raise NotImplementedError(attr_name)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **keywords: Any) -> list[Any]:
        """Refuse: the environments are no objects."""
        raise NotImplementedError(method_name)

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Return False for each environment."""
        return [False] * self.num_envs


class Curve(BaseCallback):
    """Notes the final distances of the episodes of each rollout, and stops after a time."""

    def __init__(self, arms: ReachingArms, seconds: float) -> None:
        super().__init__()
        self._arms, self._seconds, self._began = arms, seconds, time.monotonic()
        self.rows: list[dict[str, float]] = []

    def _on_rollout_end(self) -> None:
        if ended := self._arms.distances:
            self.rows.append(
                {
                    "seconds": round(time.monotonic() - self._began, 1),
                    "steps": self.num_timesteps,
                    "median_m": float(np.median(ended)),
                    "p90_m": float(np.quantile(ended, 0.9)),
                }
            )
            print(self.rows[-1], flush=True)
            ended.clear()

    def _on_step(self) -> bool:
        return time.monotonic() - self._began < self._seconds


def held_out(model: PPO, count: int) -> list[float]:
    """Return the final distances, m, of `count` episodes of seeds that training did not use."""
    arms = ReachingArms(count, seed=1_000_000)
    seen = arms.reset()
    while len(arms.distances) < count:
        seen, *_ = arms.step(model.predict(seen, deterministic=True)[0])
    arms.close()
    return arms.distances[:count]


def main() -> None:
    """Train, evaluate on held-out trials, and write the curve."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--envs", type=int, default=64)
    parser.add_argument("--out", type=Path, default=Path("out/ppo"))
    arguments = parser.parse_args()
    arms = ReachingArms(arguments.envs, seed=0)
    model = PPO(
        "MlpPolicy", arms, n_steps=TICKS, batch_size=1024, n_epochs=10, learning_rate=1e-3, gamma=0.95, seed=0,
        policy_kwargs={"log_std_init": -0.5}, device="cpu",
    )  # fmt: skip
    curve = Curve(arms, 60 * arguments.minutes)
    untrained = held_out(model, 100)
    model.learn(10**9, callback=curve)
    trained = held_out(model, 100)
    arms.close()
    arguments.out.mkdir(parents=True, exist_ok=True)
    document = {"curve": curve.rows, "untrained_m": untrained, "trained_m": trained}
    (arguments.out / "ppo_reach.json").write_text(json.dumps(document, indent=1) + "\n")
    for name, found in (("untrained", untrained), ("trained", trained)):
        near = sum(one < 0.03 for one in found)
        print(f"{name}: median {np.median(found) * 1000:.0f} mm, 90 % {np.quantile(found, 0.9) * 1000:.0f} mm, "
              f"{near} of {len(found)} within 3 cm")  # fmt: skip


if __name__ == "__main__":
    main()
