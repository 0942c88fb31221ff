"""Low-dimensional data of one frame (all values except images): content, writing and safe reading."""

from __future__ import annotations

import hashlib
import io
import pickle
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..attempt_data import ActionSequence, WeldStates
from ..errors import DatasetError
from ..geometry.se3 import Array
from .safe_unpickle import read_pickle

_PICKLE_PROTOCOL = 4  # fixed, so that bytes do not change with Python's default

RIGHT_IN_LEFT_BASE_KEY = "T_right_base_in_left_base"  # frame key; with two arms only
STATE, ACTION = "state", "action"  # frame keys; only in datasets whose actions are joint targets
GRASP, CLOTH_GRASP = "grasp", "cloth_constraint"  # frame key and its value; only in tasks with cloth

# Key -> dtype and number of dimensions of the data that replays a frame in physics. A frame has all of these keys or
# none. `sim_magnet` has one entry for each control tick; each entry has the shape of `magnet`.
SIMULATION_KEYS: Mapping[str, tuple[type[np.generic], int]] = {
    "sim_qpos": (np.float64, 1),
    "sim_ctrl": (np.float64, 2),
    "sim_magnet": (np.bool_, 1),
}

_MAX_SIM_VALUE = 1e3  # m or rad, largest valid position or command: a simulation diverges from larger start values


def frame_array_shapes(arms: int, drives: int, *, joint_actions: bool = False) -> dict[str, tuple[int, ...]]:
    """Return key -> shape of the arrays that every frame has, without the arrays of objects and cameras.

    `drives` is their number per arm, with the gripper if it has fingers. `joint_actions`: with `state` and `action`.
    """
    rows = ("joints", "ctrl", "action_joints", *((STATE, ACTION) if joint_actions else ()))
    common: dict[str, tuple[int, ...]] = dict.fromkeys(rows, (drives * arms,))
    if arms == 1:
        return common | {"ee_pose": (4, 4)}
    return common | {"ee_pose": (arms, 4, 4), RIGHT_IN_LEFT_BASE_KEY: (4, 4)}


@dataclass(frozen=True)
class SimulationData:
    """MuJoCo state and commands of a frame, in float64: a replay from float32 would drift.

    Attributes:
        qpos: positions (nq,) at the frame; object poses are in `world`.
        ctrl: drive commands of each control tick until the next frame, (ticks, nu), rad and m, in MuJoCo order. With
            two arms, MuJoCo order may differ from the order of `joints`.
        magnet: whether the weld of each arm is on during each of those ticks (ticks, arms).
    """

    qpos: ArrayLike
    ctrl: ArrayLike
    magnet: WeldStates


def make_frame(
    *,
    joints: Array,
    timestamp: float,
    intrinsics: Mapping[str, ArrayLike],
    extrinsics: Mapping[str, ArrayLike],
    object_poses: Mapping[str, ArrayLike],
    ee_pose: Array,
    ctrl: Array,
    action_joints: Array,
    magnet: WeldStates,
    language_task: str,
    language_prompt: str,
    wrist_camera: str | None = None,
    T_right_base_in_left_base: ArrayLike | None = None,
    full_openings: Sequence[float] | None = None,
    simulation: SimulationData | None = None,
    object_joints: Mapping[str, ArrayLike] | None = None,
    cloth_points: Mapping[str, ArrayLike] | None = None,
) -> dict[str, Any]:
    """Return the dictionary of one frame. Its keys are always in the same order.

    Arguments have an axis of arms, with the left arm first. The function removes this axis for a single arm, and
    concatenates the values of two arms. Poses are in the base of the only arm, or of the left arm.

    Args:
        joints: joints in rad and opening of one finger in m of each arm (arms, drives).
        timestamp: simulated time, s.
        intrinsics: camera -> K (3, 3), with pixel centres at integer coordinates.
        extrinsics: camera -> `T_cam_in_rbase` (4, 4), the OpenCV camera frame in the robot base.
        object_poses: object -> pose (4, 4) in the robot base, stored as `<object>_pose`.
        ee_pose: pose of each arm's `grasp_site` in the robot base (arms, 4, 4).
        ctrl: commands of each arm's drives (arms, drives), rad and m.
        action_joints: joints and finger opening of each arm (arms, drives) that the plan commands for the end of the
            tick.
        magnet: whether the weld of each arm holds the object (arms,).
        wrist_camera: name of the only wrist camera. Its K is also stored as `K_wrist`.
        T_right_base_in_left_base: pose (4, 4); with two arms only.
        full_openings: largest opening of one finger of each arm, m. If given, frames have the keys `state` and
            `action`: `joints` and `ctrl` with each opening as a share of the largest, 0 closed to 1 open.
        simulation: data for replaying the frame in physics; None for a real recording.
        object_joints: articulated object -> joint positions (n,), m or rad, stored as `<object>_joints`.
        cloth_points: cloth -> points (n, 3) in the robot base, m, stored as `<object>_points`; adds the key `grasp`.
    """
    data: dict[str, Any] = {
        "joints": _to_float32(joints.ravel()),
        "timestamp": float(timestamp),
        "intrinsics": {camera: _to_float32(K) for camera, K in intrinsics.items()},
        "extrinsics": {camera: _to_float32(T) for camera, T in extrinsics.items()},
    }
    data |= {f"{name}_pose": _to_float32(T) for name, T in object_poses.items()}
    data |= {f"{name}_joints": _to_float32(joints) for name, joints in (object_joints or {}).items()}
    data |= {f"{name}_points": _to_float32(points) for name, points in (cloth_points or {}).items()}
    data |= {
        "ee_pose": _to_float32(_squeeze_arms(ee_pose)),
        "ctrl": _to_float32(ctrl.ravel()),
        "action_joints": _to_float32(action_joints.ravel()),
        "magnet": np.array(magnet, dtype=np.bool_) if len(magnet) > 1 else bool(magnet[0]),
        "language_task": language_task,
        "language_prompt": language_prompt,
    }
    if cloth_points:
        data[GRASP] = CLOTH_GRASP
    if wrist_camera is not None:
        data["K_wrist"] = _to_float32(intrinsics[wrist_camera])
    if T_right_base_in_left_base is not None:
        data[RIGHT_IN_LEFT_BASE_KEY] = _to_float32(T_right_base_in_left_base)
    if full_openings is not None:
        data[STATE] = _to_float32(with_opening_shares(joints, full_openings).ravel())
        data[ACTION] = _to_float32(with_opening_shares(ctrl, full_openings).ravel())
    if simulation is not None:
        data |= {
            "sim_qpos": _to_float64(simulation.qpos),
            "sim_ctrl": _to_float64(simulation.ctrl),
            "sim_magnet": np.ascontiguousarray(_squeeze_arms(simulation.magnet, axis=1), dtype=np.bool_),
        }
    return data


def with_opening_shares(values: Array, full_openings: Sequence[float]) -> Array:
    """Return joints and finger openings (arms, drives), with openings as shares of the largest: 0 closed to 1 open."""
    shares = values.copy()
    shares[:, -1] = np.clip(shares[:, -1] / np.asarray(full_openings), 0.0, 1.0)
    return shares


def _squeeze_arms(values: NDArray[Any], axis: int = 0) -> NDArray[Any]:
    return values if values.shape[axis] > 1 else values.squeeze(axis)


def _to_float32(values: ArrayLike) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, dtype=np.float32)


def _to_float64(values: ArrayLike) -> NDArray[np.float64]:
    return np.ascontiguousarray(values, dtype=np.float64)


def dump_frame(data: Mapping[str, Any]) -> bytes:
    """Return the pickle of a frame. Equal frames give equal bytes.

    The pickle memo replaces a repeated object by a reference, so bytes would depend on whether two equal strings are
    one object. Fast mode has no memo. A frame has no cycles, so it needs no memo.
    """
    stream = io.BytesIO()
    pickler = pickle.Pickler(stream, protocol=_PICKLE_PROTOCOL)
    pickler.fast = True
    pickler.dump(dict(data))
    return stream.getvalue()


def load_frame(data: bytes) -> dict[str, Any]:
    """Decode a frame from a pickle. Raise DatasetError if the pickle is damaged, forbidden, or not a dictionary."""
    frame = read_pickle(data)
    if not isinstance(frame, dict):
        raise DatasetError(f"a frame must be a dictionary, not {type(frame).__name__}")
    return frame


def content_hash(frames: Iterable[Mapping[str, Any]]) -> str:
    """Return the SHA-256 of the decoded frame values of an episode. The hash is independent of the pickle format."""
    digest = hashlib.sha256()
    for frame in frames:
        _update_digest(digest, frame)
    return digest.hexdigest()


def _update_digest(digest: Any, value: Any) -> None:
    if isinstance(value, Mapping):
        for key in sorted(value, key=str):
            digest.update(f"{key}:".encode())
            _update_digest(digest, value[key])
    elif isinstance(value, np.ndarray):
        digest.update(f"{value.dtype.str}{value.shape}".encode())
        digest.update(np.ascontiguousarray(value).tobytes())
    else:
        digest.update(repr(value).encode())
    digest.update(b";")


def flatten_frame(frame: Mapping[str, Any]) -> dict[str, Any]:
    """Return flat key -> value of a frame. A value in a nested dictionary gets a key such as `intrinsics[camera]`."""
    entries: dict[str, Any] = {}
    for key, value in frame.items():
        if isinstance(value, Mapping):
            entries |= {f"{key}[{inner}]": item for inner, item in value.items()}
        else:
            entries[str(key)] = value
    return entries


def has_simulation_keys(frame: Mapping[str, Any]) -> bool:
    """Return whether a frame has all `SIMULATION_KEYS` keys, so that physics can replay the frame."""
    return all(key in frame for key in SIMULATION_KEYS)


def simulation_faults(frame: Mapping[str, Any]) -> list[str]:
    """Return the faults of a frame's `SIMULATION_KEYS` keys; empty if the frame has none of these keys."""
    faults: list[str] = []
    if not any(key in frame for key in SIMULATION_KEYS):
        return faults
    of_arms = getattr(frame.get("magnet"), "shape", ())
    for key, (dtype, each) in SIMULATION_KEYS.items():
        value = frame.get(key)
        dimensions = each + (len(of_arms) if key == "sim_magnet" else 0)
        if value is None:
            faults.append(f"{key} is missing")
        elif not isinstance(value, np.ndarray) or value.dtype != dtype or value.ndim != dimensions:
            found = f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__
            faults.append(f"{key} is {found}, not {np.dtype(dtype)} with {dimensions} dimensions")
        elif key == "sim_magnet" and value.shape[1:] != of_arms:
            faults.append(f"{key} has the shape {value.shape}, which does not fit magnet, {of_arms}")
        elif not (np.abs(value) < _MAX_SIM_VALUE).all():
            faults.append(f"{key} has values that are not finite, or beyond {_MAX_SIM_VALUE:g} m or rad")
    if not faults and len(frame["sim_ctrl"]) != len(frame["sim_magnet"]):
        faults.append(f"sim_ctrl has {len(frame['sim_ctrl'])} ticks and sim_magnet {len(frame['sim_magnet'])}")
    return faults


def recorded_actions(frames: Sequence[Mapping[str, Any]], nq: int, nu: int) -> tuple[Array, ActionSequence] | None:
    """Return the exact initial state of an episode and its actions.

    Args:
        frames: frames of the episode that have passed `checks.lowdim.frame_faults`.
        nq, nu: number of positions and drives of the scene.

    Returns:
        MuJoCo `qpos` (nq,) at the first frame, and the actions. None if a frame lacks simulation data, as in a real
        recording.

    Raises:
        DatasetError: the episode was recorded in another scene.
    """
    if not frames or not all(map(has_simulation_keys, frames)):
        return None
    for k, frame in enumerate(frames):
        found = len(frame["sim_qpos"]), frame["sim_ctrl"].shape[1]
        if found != (nq, nu):
            raise DatasetError(
                f"frame {k} has {found[0]} positions and {found[1]} drives, but its scene has {nq} and {nu}: "
                "the robot model or scene of the episode differs from the dataset's config"
            )
    counts = [len(frame["sim_ctrl"]) for frame in frames]
    magnet = np.concatenate([frame["sim_magnet"] for frame in frames])
    # Frames of a single arm have no axis of arms.
    magnet = magnet.reshape(len(magnet), -1)
    planned = np.array([planned_joints(frame, magnet.shape[1]) for frame in frames])
    actions = ActionSequence(
        np.concatenate([frame["sim_ctrl"] for frame in frames]), magnet, np.repeat(planned, counts, axis=0)
    )
    return frames[0]["sim_qpos"], actions


def planned_joints(frame: Mapping[str, Any], arms: int) -> Array:
    """Return the planned joints of a frame in rad and opening of one finger in m of each arm (arms, drives)."""
    joints: Array = np.asarray(frame["action_joints"], dtype=float).reshape(arms, -1)
    return joints
