"""ABC's own dataset loader, as its trainer makes it: `abc_loads.py CHECKOUT DATA OUT.npz`."""

from __future__ import annotations

import json
import sys

import numpy as np


def main(checkout: str, data: str, out: str) -> None:
    sys.path.insert(0, checkout)
    import torch
    from abc_minimal.config import DiTConfig
    from abc_minimal.preprocess import IMAGENET_MEAN, IMAGENET_STD
    from abc_minimal.train_loop import EpisodeDataset, collate

    plain = {key: {"mean": np.zeros(14, np.float32), "std": np.ones(14, np.float32)} for key in ("state", "actions")}
    config = DiTConfig()
    dataset = EpisodeDataset(data, plain, False, "none", 0.0, config)
    batch = collate([dataset[k] for k in range(len(dataset))], config.camera_keys)
    pictures = {
        camera: (255 * (images * (IMAGENET_STD + 1e-6) + IMAGENET_MEAN)).round().to(torch.uint8).numpy()
        for camera, images in batch["images"].items()
    }
    # Normalizing divides by 1 + 1e-6.
    np.savez(out, state=batch["state"].numpy(), actions=batch["actions"].numpy(), **pictures)
    episodes = [[folder.name, length, usable] for folder, length, usable, _, _ in dataset.episodes]
    print(json.dumps({"episodes": episodes, "prompts": sorted(set(batch["prompt"]))}))


if __name__ == "__main__":
    main(*sys.argv[1:])
