"""The maker's recorder writes an episode of two arms and three cameras: `maker_records.py CHECKOUT MOTION.npz OUT`.

`left`, `right`, `left_told`, `right_told` are (n, 7), `ms` (n,) times, `grey` (n,) the pictures' grey levels.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np


def main(checkout: str, motion: str, out: str) -> None:
    sys.path.insert(0, checkout)
    from yam_abc_reproduce.camera.interface import CameraFrame, CameraMode
    from yam_abc_reproduce.camera.mock_camera import MockCamera
    from yam_abc_reproduce.config import CameraConfig, RobotConfig, StationConfig
    from yam_abc_reproduce.data.recorder import EpisodeRecorder

    roles = ("top", "left", "right")
    given = np.load(motion)
    station = StationConfig(
        robot=RobotConfig(type="mock", num_arm_joints=6),
        cameras=[CameraConfig(name=role, type="mock", role=role, mode="mono") for role in roles],
        control_hz=30.0,
        save_root=out,
    )
    cameras = [MockCamera(name=role, role=role, mode=CameraMode.MONO) for role in roles]
    recorder = EpisodeRecorder(out, station, cameras, arm_names=["left", "right"])
    recorder.start("put the banana on the plate")
    for k, time in enumerate(given["ms"].tolist()):
        told = {side: given[f"{side}_told"][k] for side in ("left", "right")}
        seen = {
            side: {"joint_pos": given[side][k, :6], "gripper_pos": given[side][k, 6:]} for side in ("left", "right")
        }
        picture = np.full((96, 128, 3), given["grey"][k], np.uint8)
        frames = {role: CameraFrame(images={"rgb": picture}, timestamp_ms=time) for role in roles}
        recorder.tick(told, seen, frames)
    folder = Path(recorder.stop())
    print(json.dumps({"folder": str(folder)}))


if __name__ == "__main__":
    main(*sys.argv[1:])
