"""A recording by raiden's own recorder: `raiden_records.py CHECKOUT MOTION.npz OUT`.

Stand-ins for arms and a camera play the motion (`l` and `r` measured, `l_told` and `r_told` commanded, (n, 7)) at the
recorder's rate. Only the libraries of hardware and cloud services are replaced.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from unittest import mock

import numpy as np

sys.path.insert(0, sys.argv[1])
HARDWARE = ("boto3", "iterfzf", "pyrealsense2", "raiden.robot.controller", "raiden.control", "raiden.db.database")

with mock.patch.dict(sys.modules, {name: mock.MagicMock() for name in HARDWARE}):
    from raiden.recorder import DemonstrationRecorder

MOTION, OUT = np.load(sys.argv[2]), Path(sys.argv[3])
SECONDS_AT_MOST = 60


class Camera:
    """A camera without an image, with a timestamp."""

    name = "scene_camera"
    recording_extension = "svo2"

    def start_recording(self, path: Path) -> None:
        path.touch()

    def stop_recording(self) -> None:
        pass

    def grab(self) -> bool:
        time.sleep(1 / 30)
        return True

    def get_current_timestamp_ns(self) -> int:
        return time.time_ns()


class Controller:
    """Plays the motion, a sample per call."""

    def __init__(self) -> None:
        self.k = -1

    def get_all_observations(self) -> dict[str, dict[str, np.ndarray]]:
        self.k = min(self.k + 1, len(MOTION["l"]) - 1)
        return {
            f"follower_{side}": {
                "joint_pos": MOTION[side][self.k, :6],
                "joint_vel": np.zeros(6),
                "gripper_pos": MOTION[side][self.k, 6:],
            }
            for side in ("l", "r")
        }

    def get_last_commanded_positions(self) -> dict[str, np.ndarray]:
        return {f"follower_{side}": MOTION[f"{side}_told"][self.k] for side in ("l", "r")}

    def shutdown(self) -> None:
        pass


class Interface:
    name = "leader"


controller = Controller()
recorder = DemonstrationRecorder([Camera()], controller, OUT, "banana", "put the banana on the plate", Interface())
recorder.start_recording()
begun = time.monotonic()
while controller.k < len(MOTION["l"]) - 1 and time.monotonic() - begun < SECONDS_AT_MOST:
    time.sleep(0.01)
recorder.stop_recording()
print(json.dumps({"frames": len(recorder._robot_frames), "asked": controller.k + 1}))
