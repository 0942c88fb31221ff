"""The converted layout of the real stack, as data: every name, dtype, shape and key.

Source: TRI-ML/raiden 2353b10: what `converter.py` writes, and what `shardify.py`, `visualizer.py`, `replay.py` and
`server.py` read. Its documentation differs in places, such as on pictures. The code decides here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class RaidenForm:
    """The form of a value: an array's dtype and shape, or a plain type and ().

    Attributes:
        each: whether the value is a dictionary from every camera's name to such an array.
    """

    dtype: str
    shape: tuple[int, ...] = ()
    each: bool = False


# Numbers of an arm in the layout: six joints and the gripper; and of its hand: position (3), rotation row by row (9),
# and the gripper.
JOINTS = 6
ARM = JOINTS + 1
HAND = 3 + 9 + 1

# Key of the right base's pose in the left base. It takes a point from the right arm's base to the left one's.
BETWEEN_ARMS = "T_left_from_right"


def lowdim(width: int, recorded: int) -> Mapping[str, RaidenForm]:
    """Key -> form of a frame's dictionary, in order.

    The left arm comes first. A hand's position and rotation are in its own arm's base.

    Args:
        width: how many arms the arrays hold.
        recorded: how many arms were recorded.
    """
    return {
        "intrinsics": RaidenForm("float32", (3, 3), each=True),
        "extrinsics": RaidenForm("float32", (4, 4), each=True),
        "joints": RaidenForm("float32", (ARM * width,)),
        "action": RaidenForm("float32", (HAND * width,)),
        "actual_poses": RaidenForm("float32", (HAND * width,)),
        "action_joints": RaidenForm("float32", (ARM * width,)),
        "language_task": RaidenForm("object"),
        "language_prompt": RaidenForm("object"),
        **({BETWEEN_ARMS: RaidenForm("float32", (4, 4))} if recorded == 2 else {}),
    }


# Capture times of all frames, ns.
TIMESTAMPS = RaidenForm("int64", (-1,))
# A depth image, mm.
DEPTH = RaidenForm("uint16", (-1, -1))
DEPTH_KEY = "depth"

# Files of the dataset, of an episode, and of an episode's camera.
SHARED_METADATA = "metadata_shared.json"
SPLIT = "split_all.json"
CALIBRATION = "calibration_results.json"
METADATA = "metadata.json"
TIMESTAMPS_FILE = "timestamps.npy"


def episode_name(number: int) -> str:
    """Name of an episode's directory."""
    return f"{number:04d}"


def frame_name(frame: int, extension: str) -> str:
    """Name of a frame's file."""
    return f"{frame:010d}.{extension}"


# Keys of the JSON files; a value of None is a leaf.
Keys = Mapping[str, "Keys | None"]

METADATA_KEYS: Keys = {
    "info": {"name": None, "raw_id": None, "tags": None},
    "labels": None,
    "cameras": None,
    "resolution": None,
    "framerate": None,
    "language": {"task": None, "prompt": None},
    "num_frames": None,
    "rgb": {"extension": None},
    "intrinsics": {"model": None},
    "extrinsics": {"transform": None, "metric": None},
    "action": {"format": None, "dims": None},
    "control": None,
    # The real stack does not have the next two.
    "hand_frame": {"name": None, "description": None},
    "pictures": {"source": None},
}
# Further keys where pictures are the nearest recorded ones.
NEAREST_METADATA_KEYS: Keys = {"pictures": {"source": None, "recorded_frames": None, "recorded_period_s": None}}
# Further keys where there is depth.
DEPTH_METADATA_KEYS: Keys = {"depth": {"extension": None, "sparse": None, "metric": None}}

SPLIT_KEYS: Keys = {"filters": {}, "size": {"n_seqs": None, "n_samples": None, "n_frames": None}, "files": None}

_INTRINSICS: Keys = {"camera_matrix": None, "distortion_coeffs": None, "image_size": None, "source": None}
_TRANSFORM: Keys = {"success": None, "rotation_matrix": None, "translation_vector": None, "rotation_vector": None}
_CAMERA: Keys = {"type": None, "serial_number": None, "intrinsics": _INTRINSICS, "num_poses_used": None, "arm": None}
SCENE_CAMERA_KEYS: Keys = {**_CAMERA, "extrinsics": {**_TRANSFORM, "reference_frame": None}}
# The fork at the lab reads `extrinsics` and `arm`. `upside_down` is yamsim's own.
WRIST_CAMERA_KEYS: Keys = {
    **SCENE_CAMERA_KEYS,
    "hand_eye_calibration": {**_TRANSFORM, "method": None, "upside_down": None},
}
CALIBRATION_KEYS: Keys = {
    "version": None,
    "timestamp": None,
    "coordinate_frame": None,
    "hand_frame": {"name": None, "description": None},
    "cameras": None,
}
# Further keys for two arms. The real stack does not have the last one, which is the inverse of the first.
BIMANUAL_CALIBRATION_KEYS: Keys = {
    "bimanual_transform": {
        "right_base_to_left_base": None,
        "computed_from_calibration": None,
        "description": None,
        "T_right_base_in_left_base": None,
    }
}
