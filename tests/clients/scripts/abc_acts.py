"""ABC's environment of `put_bottles` with its physics on the CPU: `abc_acts.py CHECKOUT SEQUENCES.npz OUT.npz`.

Its learning modules and its renderer, which need a GPU, are replaced: neither changes its physics or its verdicts.
"""

from __future__ import annotations

import json
import sys
from typing import Any
from unittest.mock import MagicMock

import numpy as np


class NoRenderer:
    """Takes the place of its `MJWarpSim`, whose state the physics on the CPU does not read."""

    def __init__(self, model: Any, data: Any, *, height: int, width: int, gpu_id: int | None) -> None:
        self._qpos, self._images = np.zeros(model.nq), np.zeros((model.ncam, height, width, 3), np.uint8)

    def qpos(self) -> np.ndarray:
        return self._qpos

    def render(self) -> np.ndarray:
        return self._images

    def load_state(self) -> None: ...

    def forward(self) -> None: ...

    def close(self) -> None: ...


def main(checkout: str, sequences: str, out: str) -> None:
    sys.path.insert(0, checkout)
    for name in ("torch", "abc_minimal.dit", "abc_minimal.fast_inference", "abc_minimal.preprocess"):
        sys.modules[name] = MagicMock()
    import mujoco
    from abc_minimal import eval_policy
    from abc_minimal.config import PutBottlesSimConfig, SimEvalConfig

    eval_policy.MJWarpSim = NoRenderer
    config = SimEvalConfig(checkpoint="")
    env = eval_policy.PutBottlesEnv(
        height=config.camera_height,
        width=config.camera_width,
        camera_keys=config.model.camera_keys,
        prompt=config.prompt,
        scene=PutBottlesSimConfig(),
    )
    given = np.load(sequences)
    found: dict[str, list[Any]] = {"qpos": [], "state": [], "in_bin": [], "success": [], "most": []}
    for seed, filled, actions in zip(given["seeds"], given["filled"], given["actions"], strict=True):
        env.reset(int(seed))
        start = env.data.qpos.copy()
        if filled:
            fill_bin(env)
        rows, states, masks = [start], [], []
        for action in actions:
            env.step_one_vanilla(action)
            told = env.evaluate_vanilla()
            rows.append(env.data.qpos.copy())
            states.append(env.get_state_vanilla())
            masks.append(told["bottle_in_bin_mask"])
        for key, value in (("qpos", rows), ("state", states), ("in_bin", masks)):
            found[key].append(np.array(value))
        found["success"].append(told["ever_success"])
        found["most"].append(told["max_bottles_in_bin_so_far"])
    np.savez(out, **{key: np.array(value) for key, value in found.items()})
    told = {"keys": sorted(env.obs()), "cameras": list(env.camera_keys), "prompt": config.prompt}
    loop = {"seed": config.seed, "actions": config.num_chunks * config.execute_chunk_dim}
    size = [config.camera_width, config.camera_height]
    print(json.dumps(told | loop | {"execute": config.execute_chunk_dim, "size": size, "engine": mujoco.__version__}))


def fill_bin(env: Any) -> None:
    """Put all bottles above each other into the bin, as the test does in yamsim's scene."""
    position = env.data.qpos[env.evaluator.bin_qpos_adr :][:3]
    for k, address in enumerate(env.evaluator.bottle_qpos_addrs):
        env.data.qpos[address : address + 3] = position + np.array([0.0, 0.0, 0.04 * k])


if __name__ == "__main__":
    main(*sys.argv[1:])
