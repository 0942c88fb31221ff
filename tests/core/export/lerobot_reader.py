"""Read a dataset with lerobot's own loader, in whatever Python has it: `python FILE DATASET OUT.npz`."""

import sys

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset


def main(root: str, out: str) -> None:
    dataset = LeRobotDataset("local/exported", root=root, video_backend="pyav")
    frames = [dataset[index] for index in range(len(dataset))]
    keys = [key for key in frames[0] if key != "task"]
    arrays = {key: np.stack([np.asarray(frame[key]) for frame in frames]) for key in keys}
    np.savez(out, task=np.array([frame["task"] for frame in frames]), fps=dataset.fps, **arrays)


if __name__ == "__main__":
    main(*sys.argv[1:])
