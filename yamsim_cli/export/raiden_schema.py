"""Raiden's converted layout: files, keys and sizes, and the options of an export.

Source: TRI-ML/raiden 2353b10, output of `converter.py` and input of `shardify.py`, `visualizer.py`, `replay.py` and
`server.py`. This module follows raiden's code where its documentation differs, for example on images.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

# "draw" renders at the time of each frame; "nearest" takes the recorded image nearest in time.
PictureSource = Literal["draw", "nearest"]
ImageFormat = Literal["png", "jpg"]  # raiden's code reads only PNG
HandFrameName = Literal["yamsim", "i2rt"]  # arm model whose hand frame and kinematics give the hand poses

FPS = 30.0  # that raiden's commands `rd replay` and `rd shardify` assume

JOINTS = 6  # joints per arm in the layout
ARM_VALUES = JOINTS + 1  # values per arm: joints and gripper

RIGHT_BASE_POSE_KEY = "T_left_from_right"  # key of the pose of the right base in the left base

TIMESTAMP_DTYPE = "int64"  # dtype of capture times, ns
DEPTH_DTYPE = "uint16"  # dtype of depth images, mm
DEPTH_KEY = "depth"  # array name in a depth `.npz`

# Files of the dataset, of an episode, and of an episode's camera.
SHARED_METADATA_FILE = "metadata_shared.json"
SPLIT_FILE = "split_all.json"
CALIBRATION_FILE = "calibration_results.json"
METADATA_FILE = "metadata.json"
TIMESTAMPS_FILE = "timestamps.npy"


@dataclass(frozen=True)
class RaidenOptions:
    """Options of an export to raiden's layout.

    Attributes:
        fps: frames per second; None for exactly the recorded frames.
        pictures: source of the images; ignored if `fps` is None.
        hand_frame: hand frame of the poses in `action` and `actual_poses`, and its kinematics.
    """

    fps: float | None = FPS
    pictures: PictureSource = "draw"
    images: ImageFormat = "png"
    as_single_arm: bool = False
    hand_frame: HandFrameName = "yamsim"

    @property
    def renders_images(self) -> bool:
        """Whether the export renders images."""
        return self.fps is not None and self.pictures == "draw"


def episode_name(number: int) -> str:
    """Return the directory name of an episode."""
    return f"{number:04d}"


def frame_name(frame: int, extension: str) -> str:
    """Return the file name of a frame's data or image."""
    return f"{frame:010d}.{extension}"


def nearest_pictures(frames: Sequence[int], period: float) -> dict[str, Any]:
    """Return metadata.json's entry for images that are copied from the nearest recorded frames.

    Args:
        frames: for each exported frame, the number of the recorded frame whose image it has.
        period: time between recorded frames, s.
    """
    return {"source": "nearest", "recorded_frames": list(frames), "recorded_period_s": period}
