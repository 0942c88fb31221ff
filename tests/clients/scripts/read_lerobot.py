"""Read a dataset with lerobot's own loader: `python FILE DATASET OUT.npz`."""

import json
import sys

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

try:
    from lerobot.utils.feature_utils import dataset_to_policy_features
except ModuleNotFoundError:
    from lerobot.datasets.utils import dataset_to_policy_features


def main(root: str, out: str) -> None:
    dataset = LeRobotDataset("local/exported", root=root, video_backend="pyav")
    frames = [dataset[index] for index in range(len(dataset))]
    keys = [key for key in frames[0] if key != "task"]
    np.savez(out, **{key: np.stack([np.asarray(frame[key]) for frame in frames]) for key in keys})
    policy = {key: feature.type.value for key, feature in dataset_to_policy_features(dataset.meta.features).items()}
    answer = {
        "fps": dataset.fps,
        "tasks": sorted({frame["task"] for frame in frames}),
        "policy": policy,
        "stats": sorted(dataset.meta.stats),
        "state_mean": np.asarray(dataset.meta.stats["observation.state"]["mean"]).tolist(),
    }
    print(json.dumps(answer))


if __name__ == "__main__":
    main(*sys.argv[1:])
