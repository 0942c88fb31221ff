"""The converted layout of the real stack, as data: every name, dtype, shape and key.

Source: TRI-ML/raiden 2353b10: what `converter.py` writes; what `shardify.py`, `visualizer.py`, `replay.py` and
`server.py` read. Its documentation says otherwise in places, of pictures for one; the code is what reads.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Form:
    """What a value is: an array's dtype and shape, or a plain type and ().

    Attributes:
        each: the value is a dictionary from every camera's name to such an array.
    """

    dtype: str
    shape: tuple[int, ...] = ()
    each: bool = False


# Where the right arm's base stands in the left one's: what takes a point from the right arm's base to the left one's.
BETWEEN_ARMS = "T_left_from_right"


def lowdim(width: int, recorded: int) -> Mapping[str, Form]:
    """Of a frame's dictionary, in order.

    Arms are left, then right: joints (6) and gripper (1); or position (3), rotation row by row (9) and gripper (1) of
    the hand in its arm's own base.

    Args:
        width: how many arms its arrays hold.
        recorded: how many there were.
    """
    return {
        "intrinsics": Form("float32", (3, 3), each=True),
        "extrinsics": Form("float32", (4, 4), each=True),
        "joints": Form("float32", (7 * width,)),
        "action": Form("float32", (13 * width,)),
        "actual_poses": Form("float32", (13 * width,)),
        "action_joints": Form("float32", (7 * width,)),
        "language_task": Form("object"),
        "language_prompt": Form("object"),
        **({BETWEEN_ARMS: Form("float32", (4, 4))} if recorded == 2 else {}),
    }


# Nanoseconds of each frame, and millimetres of each pixel.
TIMESTAMPS = Form("int64", (-1,))
DEPTH = Form("uint16", (-1, -1))
DEPTH_KEY = "depth"

# Files of the dataset, of an episode, and of an episode's camera.
SHARED_METADATA = "metadata_shared.json"
SPLIT = "split_all.json"
CALIBRATION = "calibration_results.json"
METADATA = "metadata.json"
TIMESTAMPS_FILE = "timestamps.npy"


def episode_name(number: int) -> str:
    """Directory of an episode."""
    return f"{number:04d}"


def frame_name(frame: int, extension: str) -> str:
    """File of a frame."""
    return f"{frame:010d}.{extension}"


# Keys of the JSON files; a value of None is a leaf, `*` stands for every camera.
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
    # These are not in the real stack's.
    "hand_frame": {"name": None, "description": None},
    "pictures": {"source": None},
}
# Where pictures are the nearest recorded ones, on top.
NEAREST_METADATA_KEYS: Keys = {"pictures": {"source": None, "recorded_frames": None, "recorded_period_s": None}}
# Where there is depth, on top.
DEPTH_METADATA_KEYS: Keys = {"depth": {"extension": None, "sparse": None, "metric": None}}

SPLIT_KEYS: Keys = {"filters": {}, "size": {"n_seqs": None, "n_samples": None, "n_frames": None}, "files": None}

_INTRINSICS: Keys = {"camera_matrix": None, "distortion_coeffs": None, "image_size": None, "source": None}
_TRANSFORM: Keys = {"success": None, "rotation_matrix": None, "translation_vector": None, "rotation_vector": None}
_CAMERA: Keys = {"type": None, "serial_number": None, "intrinsics": _INTRINSICS, "num_poses_used": None, "arm": None}
SCENE_CAMERA_KEYS: Keys = {**_CAMERA, "extrinsics": {**_TRANSFORM, "reference_frame": None}}
# `extrinsics` and `arm` are what the fork at the lab reads, `upside_down` is nobody's but ours.
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
# Of two arms, on top. The last one, a plain name for the inverse of the first, is not in the real stack's.
BIMANUAL_CALIBRATION_KEYS: Keys = {
    "bimanual_transform": {
        "right_base_to_left_base": None,
        "computed_from_calibration": None,
        "description": None,
        "T_right_base_in_left_base": None,
    }
}
