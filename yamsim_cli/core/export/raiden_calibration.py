"""The calibration file of a dataset's cameras, which both raiden and its fork at the lab read.

raiden reads a wrist camera's `hand_eye_calibration`, and any other camera's `extrinsics`. The fork's scripts read the
`extrinsics` of all cameras, so a wrist camera has both. Neither reads `type`.

Source: TRI-ML/raiden 2353b10, `converter.py` and `server.py`; cameronosmith/raiden_fork 434d7c6, `wrist_calibrate.py`,
`exo_calibrate.py`, `wrist_verify_rerun.py`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.se3 import Array, inverse, pose, rotation_vector
from . import raiden_schema as schema
from .raiden_frames import WRIST_CAMERAS, FrameConverter, hand_frame, wrist_arms
from .raiden_options import RaidenOptions
from .source import Source

_ZERO_TIME = "1970-01-01T00:00:00.000000"
_SIDES = ("left", "right")

# A real right wrist camera hangs upside down. raiden's code turns its pictures and its hand-eye pose by half a turn, so
# that the file has to hold the pose before that turn. Source: TRI-ML/raiden, `converter.py`, `server.py`.
_UPSIDE_DOWN = (WRIST_CAMERAS[1],)
_HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])


def calibration(
    source: Source, converter: FrameConverter, options: RaidenOptions, frames: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """The content of `calibration_results.json`.

    Args:
        frames: converted frames of one episode. A wrist camera's position is their mean: by other kinematics than the
            simulated arm's, the hand-eye pose differs slightly from frame to frame.
    """
    between = frames[0].get(schema.BETWEEN_ARMS)
    T = None if between is None else np.asarray(between, np.float64)
    wrists = wrist_arms(source)
    cameras: dict[str, Any] = {}
    for camera, size in source.cameras.items():
        name = converter.names[camera]
        entry = {
            "serial_number": 0,
            "intrinsics": _intrinsics(frames[0]["intrinsics"][name], size),
            "num_poses_used": 0,
        }
        seen = [np.asarray(frame["extrinsics"][name], np.float64) for frame in frames]
        cameras[name] = (
            _wrist(name, wrists[camera], entry, converter, seen, frames, T)
            if camera in wrists
            else {
                "type": "scene",
                **entry,
                "arm": _SIDES[0],
                "extrinsics": {**_transform(seen[0]), "reference_frame": "left_arm_base"},
            }
        )
    return {
        "version": "1.0",
        "timestamp": _ZERO_TIME,
        "coordinate_frame": "left_arm_base",
        "hand_frame": hand_frame(options.hand_frame),
        "cameras": cameras,
        **({} if T is None else {"bimanual_transform": _bimanual(T)}),
    }


def _wrist(
    name: str,
    arm: int,
    entry: Mapping[str, Any],
    converter: FrameConverter,
    seen: Sequence[Array],
    frames: Sequence[Mapping[str, Any]],
    T_right_base_in_left_base: Array | None,
) -> dict[str, Any]:
    to_base = np.eye(4)
    if arm == 1 and T_right_base_in_left_base is not None:
        to_base = inverse(T_right_base_in_left_base)
    hands = [converter.T_hand_in_base(arm, frame["joints"]) for frame in frames]
    in_hand = [inverse(hand) @ to_base @ T for hand, T in zip(hands, seen, strict=True)]
    T = pose(np.mean([T[:3, 3] for T in in_hand], axis=0), in_hand[0][:3, :3])
    hung = T @ _HALF_TURN if name in _UPSIDE_DOWN else T
    return {
        "type": "hand_eye",
        **entry,
        "arm": _SIDES[arm],
        "hand_eye_calibration": {**_transform(hung), "method": "sim", "upside_down": name in _UPSIDE_DOWN},
        "extrinsics": {**_transform(T), "reference_frame": f"{_SIDES[arm]}_grasp_site"},
    }


def _intrinsics(K: ArrayLike, size: tuple[int, int]) -> dict[str, Any]:
    return {
        "camera_matrix": np.asarray(K).tolist(),
        "distortion_coeffs": [0.0] * 5,
        "image_size": list(size),
        "source": "simulation",
    }


def _bimanual(T_right_base_in_left_base: Array) -> dict[str, Any]:
    """The arms' places. Source: TRI-ML/raiden, `converter.py`, which inverts what it reads under the first key."""
    return {
        "right_base_to_left_base": inverse(T_right_base_in_left_base).tolist(),
        "computed_from_calibration": False,
        "description": "Pose of the left arm's base in the right one's: the inverse of T_right_base_in_left_base",
        "T_right_base_in_left_base": T_right_base_in_left_base.tolist(),
    }


def _transform(T: Array) -> dict[str, Any]:
    return {
        "success": True,
        "rotation_matrix": T[:3, :3].tolist(),
        "translation_vector": T[:3, 3].tolist(),
        "rotation_vector": rotation_vector(T[:3, :3]).tolist(),
    }
