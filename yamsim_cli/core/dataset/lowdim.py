"""The low-dimensional data of one frame: what it holds, and how it is written and safely read."""

from __future__ import annotations

import hashlib
import io
import pickle
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import DatasetError
from .unpickle import read_pickle

# Fixed, so that the bytes do not change with Python's default.
_PROTOCOL = 4

# Shapes of the arrays every frame has; `<object>_pose` and per-camera entries come on top.
SHAPES: Mapping[str, tuple[int, ...]] = {
    "joints": (7,),
    "ee_pose": (4, 4),
    "ctrl": (7,),
    "action_joints": (7,),
}


def frame_data(
    *,
    joints: ArrayLike,
    timestamp: float,
    intrinsics: Mapping[str, ArrayLike],
    extrinsics: Mapping[str, ArrayLike],
    object_poses: Mapping[str, ArrayLike],
    ee_pose: ArrayLike,
    ctrl: ArrayLike,
    action_joints: ArrayLike,
    magnet: bool,
    language_task: str,
    language_prompt: str,
    wrist_camera: str | None = None,
) -> dict[str, Any]:
    """One frame's dictionary, its keys always in the same order.

    Args:
        joints: six joints in rad and the opening of one finger in m, (7,).
        timestamp: simulated time, s.
        intrinsics: camera -> K (3, 3), pixel centres at whole numbers.
        extrinsics: camera -> `T_cam_in_rbase` (4, 4), OpenCV's camera frame in the robot's base.
        object_poses: object -> pose (4, 4) in the robot's base, stored as `<object>_pose`.
        ee_pose: pose (4, 4) of `grasp_site` in the robot's base.
        ctrl: what the seven drives were told, rad and m.
        action_joints: the joints and finger opening the plan asked for at the end of the tick, (7,).
        magnet: whether the weld holds the object.
        wrist_camera: the wrist camera's name; its K is then stored as `K_wrist` too.
    """
    data: dict[str, Any] = {
        "joints": _f32(joints),
        "timestamp": float(timestamp),
        "intrinsics": {camera: _f32(K) for camera, K in intrinsics.items()},
        "extrinsics": {camera: _f32(T) for camera, T in extrinsics.items()},
    }
    data |= {f"{name}_pose": _f32(T) for name, T in object_poses.items()}
    data |= {
        "ee_pose": _f32(ee_pose),
        "ctrl": _f32(ctrl),
        "action_joints": _f32(action_joints),
        "magnet": bool(magnet),
        "language_task": language_task,
        "language_prompt": language_prompt,
    }
    if wrist_camera is not None:
        data["K_wrist"] = _f32(intrinsics[wrist_camera])
    return data


def _f32(values: ArrayLike) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, dtype=np.float32)


def dump_frame(data: Mapping[str, Any]) -> bytes:
    """Pickle a frame; equal frames give equal bytes.

    Pickle's memo writes a reference where it meets an object again, so the bytes would depend on whether two equal
    strings happen to be one object. Fast mode has no memo; a frame has no cycles that would need it.
    """
    stream = io.BytesIO()
    pickler = pickle.Pickler(stream, protocol=_PROTOCOL)
    pickler.fast = True
    pickler.dump(dict(data))
    return stream.getvalue()


def load_frame(data: bytes) -> dict[str, Any]:
    """Read a frame's pickle, allowing numpy arrays and plain containers alone.

    Raises:
        ForbiddenPickleError: it names anything else, or would take more memory than a frame may.
        DatasetError: truncated, not a pickle, or not a dictionary.
    """
    frame = read_pickle(data)
    if not isinstance(frame, dict):
        raise DatasetError(f"a frame must be a dictionary, not {type(frame).__name__}")
    return frame


def content_hash(frames: Iterable[Mapping[str, Any]]) -> str:
    """SHA-256 over the decoded values of an episode's frames: the same whatever pickle made of them."""
    digest = hashlib.sha256()
    for frame in frames:
        _feed(digest, frame)
    return digest.hexdigest()


def _feed(digest: Any, value: Any) -> None:
    if isinstance(value, Mapping):
        for key in sorted(value, key=str):
            digest.update(f"{key}:".encode())
            _feed(digest, value[key])
    elif isinstance(value, np.ndarray):
        digest.update(f"{value.dtype.str}{value.shape}".encode())
        digest.update(np.ascontiguousarray(value).tobytes())
    else:
        digest.update(repr(value).encode())
    digest.update(b";")


def flat(frame: Mapping[str, Any]) -> dict[str, Any]:
    """A frame's entries by flat keys: what a dictionary in it holds becomes `key[inner]`: `intrinsics[camera]`."""
    entries: dict[str, Any] = {}
    for key, value in frame.items():
        if isinstance(value, Mapping):
            entries |= {f"{key}[{inner}]": item for inner, item in value.items()}
        else:
            entries[str(key)] = value
    return entries
