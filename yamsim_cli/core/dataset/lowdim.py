"""The low-dimensional data of one frame: what it holds, and how it is written and safely read."""

from __future__ import annotations

import hashlib
import io
import pickle
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import DatasetError

# Fixed, so that the bytes do not change with Python's default.
_PROTOCOL = 4

# Everything a frame's pickle may name: numpy arrays, by numpy 2's and numpy 1's module names. Anything else is an
# attack, or a file of some other program.
_ALLOWED = {
    (module, name)
    for core in ("numpy._core", "numpy.core")
    for module, name in (
        (f"{core}.multiarray", "_reconstruct"),
        (f"{core}.multiarray", "scalar"),
        (f"{core}.numeric", "_frombuffer"),
    )
} | {("numpy", "ndarray"), ("numpy", "dtype")}

# Shapes of the arrays every frame has; `<object>_pose` and per-camera entries come on top.
SHAPES: Mapping[str, tuple[int, ...]] = {
    "joints": (7,),
    "ee_pose": (4, 4),
    "ctrl": (7,),
    "action_joints": (7,),
}

# Dtype and number of dimensions of the keys that simulation alone has: a frame has all of them or none.
_SIMULATION: Mapping[str, tuple[type[np.generic], int]] = {
    "sim_qpos": (np.float64, 1),
    "sim_ctrl": (np.float64, 2),
    "sim_magnet": (np.bool_, 1),
}

# Nothing on a table is farther away, m or rad; a simulation that starts with larger numbers blows up.
_FARTHEST = 1e3


@dataclass(frozen=True)
class SimulationData:
    """A frame as the simulator has it, in its own precision: rounded to float32, a replay would drift off.

    Attributes:
        qpos: MuJoCo's positions (nq,) at the frame, objects in `world`.
        ctrl: what the drives are told on each control tick until the next frame, (ticks, nu), rad and m.
        magnet: whether the weld holds on each of those ticks, (ticks,).
    """

    qpos: ArrayLike
    ctrl: ArrayLike
    magnet: ArrayLike


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
    simulation: SimulationData | None = None,
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
        simulation: what makes the frame repeatable in physics; a real recording has none.
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
    if simulation is not None:
        data |= {
            "sim_qpos": _f64(simulation.qpos),
            "sim_ctrl": _f64(simulation.ctrl),
            "sim_magnet": np.ascontiguousarray(simulation.magnet, dtype=np.bool_),
        }
    return data


def _f32(values: ArrayLike) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, dtype=np.float32)


def _f64(values: ArrayLike) -> NDArray[np.float64]:
    return np.ascontiguousarray(values, dtype=np.float64)


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


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _ALLOWED:
            raise DatasetError(f"the pickle names {module}.{name}, which no frame may; it was not run")
        return super().find_class(module, name)


def load_frame(data: bytes) -> dict[str, Any]:
    """Read a frame's pickle, allowing numpy arrays and plain containers alone.

    Raises:
        DatasetError: truncated, not a pickle, names anything else, or is not a dictionary.
    """
    try:
        frame = _Unpickler(io.BytesIO(data)).load()
    except DatasetError:
        raise
    # A broken pickle can make the machine it drives fail in any of these ways.
    except (
        pickle.UnpicklingError,
        EOFError,
        ValueError,
        TypeError,
        KeyError,
        IndexError,
        AttributeError,
        MemoryError,
        ImportError,
        OverflowError,
        RecursionError,
        SyntaxError,
        SystemError,
    ) as error:
        raise DatasetError(f"not a whole pickle: {type(error).__name__}: {error}") from error
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
        for key in sorted(value):
            digest.update(f"{key}:".encode())
            _feed(digest, value[key])
    elif isinstance(value, np.ndarray):
        digest.update(f"{value.dtype.str}{value.shape}".encode())
        digest.update(np.ascontiguousarray(value).tobytes())
    else:
        digest.update(repr(value).encode())
    digest.update(b";")


def frame_faults(frame: Mapping[str, Any], objects: Iterable[str], cameras: Iterable[str]) -> list[str]:
    """What is wrong with a decoded frame: missing keys, wrong shapes, dtypes or types, values that are not finite."""
    faults: list[str] = []
    arrays: dict[str, tuple[Any, tuple[int, ...]]] = {key: (frame.get(key), shape) for key, shape in SHAPES.items()}
    arrays |= {f"{name}_pose": (frame.get(f"{name}_pose"), (4, 4)) for name in objects}
    for group, side in (("intrinsics", 3), ("extrinsics", 4)):
        entries = frame.get(group)
        for camera in cameras:
            arrays[f"{group}[{camera}]"] = (entries.get(camera) if isinstance(entries, Mapping) else None, (side, side))
    for key, (value, shape) in arrays.items():
        if value is None:
            faults.append(f"{key} is missing")
        elif not isinstance(value, np.ndarray) or value.dtype != np.float32 or value.shape != shape:
            found = f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__
            faults.append(f"{key} is {found}, not float32 {shape}")
        elif not np.isfinite(value).all():
            faults.append(f"{key} has values that are not finite")
    faults += _simulation_faults(frame)
    for key, kind in (("timestamp", float), ("magnet", bool), ("language_task", str), ("language_prompt", str)):
        if not isinstance(frame.get(key), kind):
            faults.append(f"{key} is {type(frame.get(key)).__name__}, not {kind.__name__}")
    timestamp = frame.get("timestamp")
    if isinstance(timestamp, float) and not np.isfinite(timestamp):
        faults.append("timestamp is not finite")
    return faults


def has_simulation(frame: Mapping[str, Any]) -> bool:
    """Whether a frame holds what physics needs to repeat it."""
    return all(key in frame for key in _SIMULATION)


def _simulation_faults(frame: Mapping[str, Any]) -> list[str]:
    faults: list[str] = []
    if not any(key in frame for key in _SIMULATION):
        return faults
    for key, (dtype, dimensions) in _SIMULATION.items():
        value = frame.get(key)
        if value is None:
            faults.append(f"{key} is missing")
        elif not isinstance(value, np.ndarray) or value.dtype != dtype or value.ndim != dimensions:
            found = f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__
            faults.append(f"{key} is {found}, not {np.dtype(dtype)} with {dimensions} dimensions")
        elif not (np.abs(value) < _FARTHEST).all():
            faults.append(f"{key} has values that are not finite, or beyond {_FARTHEST:g} m or rad")
    if not faults and len(frame["sim_ctrl"]) != len(frame["sim_magnet"]):
        faults.append(f"sim_ctrl has {len(frame['sim_ctrl'])} ticks and sim_magnet {len(frame['sim_magnet'])}")
    return faults
