"""The converted layout of the real stack: its files, keys and sizes, and the options of an export to it.

Source: TRI-ML/raiden 2353b10: what `converter.py` writes, and what `shardify.py`, `visualizer.py`, `replay.py` and
`server.py` read. Where raiden's documentation differs, such as on pictures, the code decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

# "draw" renders a picture at each frame's time; "nearest" takes the recorded picture nearest in time.
PictureSource = Literal["draw", "nearest"]
ImageFormat = Literal["png", "jpg"]  # raiden's code reads only PNG
HandFrameName = Literal["yamsim", "i2rt"]  # kinematics for poses of hands, see `raiden_frames.hand_frame`

FPS = 30.0  # frames per second: `rd replay` plays at this rate, and `rd shardify` counts windows in its frames

# Numbers of an arm in the layout: joints, and joints with the gripper.
JOINTS = 6
ARM = JOINTS + 1

# Key of the right base's pose in the left base: it maps points from the right base to the left one.
BETWEEN_ARMS = "T_left_from_right"

TIMESTAMP_DTYPE = "int64"  # of capture times, ns
DEPTH_DTYPE = "uint16"  # of depth images, mm
DEPTH_KEY = "depth"

# Files of the dataset, of an episode, and of an episode's camera.
SHARED_METADATA = "metadata_shared.json"
SPLIT = "split_all.json"
CALIBRATION = "calibration_results.json"
METADATA = "metadata.json"
TIMESTAMPS_FILE = "timestamps.npy"


@dataclass(frozen=True)
class RaidenOptions:
    """The options of an export.

    Attributes:
        fps: frames per second; None for exactly the recorded frames.
        pictures: their source, if `fps` is given.
        images: format of the pictures.
        single: whether arrays hold a lone arm without a right arm that stands still.
        hand_frame: the kinematics for `action` and `actual_poses`.
    """

    fps: float | None = FPS
    pictures: PictureSource = "draw"
    images: ImageFormat = "png"
    single: bool = False
    hand_frame: HandFrameName = "yamsim"

    @property
    def renders(self) -> bool:
        """Whether the export renders pictures."""
        return self.fps is not None and self.pictures == "draw"


def episode_name(number: int) -> str:
    """Name of an episode's directory."""
    return f"{number:04d}"


def frame_name(frame: int, extension: str) -> str:
    """Name of a frame's file."""
    return f"{frame:010d}.{extension}"


def nearest_pictures(frames: Sequence[int], period: float) -> dict[str, Any]:
    """The metadata's entry on pictures of the nearest recorded frames, recorded every `period` s."""
    return {"source": "nearest", "recorded_frames": list(frames), "recorded_period_s": period}
