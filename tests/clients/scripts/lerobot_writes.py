"""A dataset by LeRobot's own writer: `lerobot_writes.py MOTIONS.npz OUT films|pictures`.

Each episode has `state{k}` and `action{k}` (n, 14); `grey{k}` (n,) is the grey level of its pictures.
"""

import json
import sys

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

SHAPE = (96, 128, 3)


def main(motions: str, out: str, kind: str) -> None:
    given = np.load(motions)
    names = given["names"].tolist()
    row = {"dtype": "float32", "shape": (len(names),), "names": names}
    camera = {
        "dtype": "video" if kind == "films" else "image",
        "shape": SHAPE,
        "names": ["height", "width", "channels"],
    }
    features = {"observation.state": row, "action": row, "observation.images.top": camera}
    dataset = LeRobotDataset.create(
        "local/written",
        fps=int(given["fps"]),
        features=features,
        root=out,
        robot_type="bi_yam_follower",
        use_videos=kind == "films",
    )
    for number in range(int(given["episodes"])):
        rows = zip(given[f"state{number}"], given[f"action{number}"], given[f"grey{number}"], strict=True)
        for state, action, grey in rows:
            dataset.add_frame(
                {
                    "observation.state": state.astype(np.float32),
                    "action": action.astype(np.float32),
                    "observation.images.top": np.full(SHAPE, grey, np.uint8),
                    "task": f"task {number}",
                }
            )
        dataset.save_episode()
    dataset.finalize()
    print(json.dumps({"episodes": dataset.num_episodes, "frames": dataset.num_frames}))


if __name__ == "__main__":
    main(*sys.argv[1:])
