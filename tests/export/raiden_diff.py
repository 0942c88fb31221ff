"""The layout of raiden as data, and the differences of an export from it.

Source: TRI-ML/raiden 2353b10, `converter.py`, `shardify.py`, `visualizer.py`, `replay.py` and `server.py`.
"""

from __future__ import annotations

import json
import pickle
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from yamsim_cli.export import raiden_schema as schema

Form = tuple[str, tuple[int, ...]]  # dtype and shape of an array, or a plain type and ()

# An arm has six joints and its gripper; a hand its position, its row-major rotation, and the gripper.
_ARM, _HAND = 7, 13
# Key -> form of a frame's values for one arm, in order; the left arm comes first, a hand is in its own arm's base.
_FRAME: Mapping[str, Form] = {
    "intrinsics": ("float32", (3, 3)),
    "extrinsics": ("float32", (4, 4)),
    "joints": ("float32", (_ARM,)),
    "action": ("float32", (_HAND,)),
    "actual_poses": ("float32", (_HAND,)),
    "action_joints": ("float32", (_ARM,)),
    "language_task": ("object", ()),
    "language_prompt": ("object", ()),
}
_OF_CAMERAS = ("intrinsics", "extrinsics")

# Keys of the JSON files, nested keys with dots. raiden itself has neither `hand_frame` nor `pictures`.
_METADATA = """
    info.name info.raw_id info.tags labels cameras resolution framerate language.task language.prompt num_frames
    rgb.extension intrinsics.model extrinsics.transform extrinsics.metric action.format action.dims control
    hand_frame.name hand_frame.description pictures.source
"""
_NEAREST = "pictures.recorded_frames pictures.recorded_period_s"
_DEPTH = "depth.extension depth.sparse depth.metric"
_SPLIT = "size.n_seqs size.n_samples size.n_frames"
_CALIBRATION = "version timestamp coordinate_frame hand_frame.name hand_frame.description"
# raiden itself does not have the last key, which is the inverse of the first.
_BIMANUAL = " ".join(
    f"bimanual_transform.{key}"
    for key in ("right_base_to_left_base", "computed_from_calibration", "description", "T_right_base_in_left_base")
)
_TRANSFORM = ("success", "rotation_matrix", "translation_vector", "rotation_vector")
_CAMERA = " ".join(
    [
        "type serial_number num_poses_used arm extrinsics.reference_frame",
        *(f"intrinsics.{key}" for key in ("camera_matrix", "distortion_coeffs", "image_size", "source")),
        *(f"extrinsics.{key}" for key in _TRANSFORM),
    ]
)
# The lab's fork reads `extrinsics` and `arm`. `upside_down` is yamsim's own.
_HAND_EYE = " ".join(f"hand_eye_calibration.{key}" for key in (*_TRANSFORM, "method", "upside_down"))


def frames_of(episode: Path) -> list[dict[str, Any]]:
    """The frames of an exported episode."""
    return [pickle.loads(file.read_bytes()) for file in sorted((episode / "lowdim").iterdir())]


def column(frames: list[dict[str, Any]], key: str) -> np.ndarray:
    return np.array([frame[key] for frame in frames])


def differences(root: Path, *, arms: int = 1, single: bool = False) -> list[str]:
    """Return the differences of an export of `arms` arms, one text each; with `single`, arrays hold one arm."""
    return list(_dataset(root, arms, 1 if single else 2))


def _dataset(root: Path, arms: int, width: int) -> Iterator[str]:
    split = json.loads((root / schema.SPLIT_FILE).read_text())
    files = split.pop("files")
    yield from _keys(schema.SPLIT_FILE, {key: value for key, value in split.items() if value}, _SPLIT)
    yield from _names(root, {schema.SPLIT_FILE, schema.SHARED_METADATA_FILE, schema.CALIBRATION_FILE, *files})
    size = {"n_seqs": len(files), "n_samples": len(files), "n_frames": sum(files.values())}
    if split != {"filters": {}, "size": size}:
        yield f"{schema.SPLIT_FILE} is {split}, not of {size}"
    if list(files) != [schema.episode_name(k) for k in range(len(files))]:
        yield f"{schema.SPLIT_FILE}: episodes are {list(files)}"
    for name, frames in files.items():
        yield from _episode(root / name, frames, arms, width)
    first = root / next(iter(files)) / schema.METADATA_FILE
    if (root / schema.SHARED_METADATA_FILE).read_bytes() != first.read_bytes():
        yield f"{schema.SHARED_METADATA_FILE} is not that of the first episode"
    calibration = json.loads((root / schema.CALIBRATION_FILE).read_text())
    cameras = calibration.pop("cameras")
    yield from _keys(schema.CALIBRATION_FILE, calibration, _CALIBRATION, _BIMANUAL if arms == 2 else "")
    if list(cameras) != json.loads(first.read_text())["cameras"]:
        yield f"{schema.CALIBRATION_FILE}: cameras are {list(cameras)}"
    for name, entry in cameras.items():
        yield from _keys(name, entry, _CAMERA, _HAND_EYE if entry["type"] == "hand_eye" else "")


def _episode(folder: Path, frames: int, arms: int, width: int) -> Iterator[str]:
    metadata = json.loads((folder / schema.METADATA_FILE).read_text())
    depth, cameras = "depth" in metadata["labels"], metadata["cameras"]
    nearest = metadata["pictures"]["source"] == "nearest"
    yield from _keys(folder.name, metadata, _METADATA, _DEPTH if depth else "", _NEAREST if nearest else "")
    if metadata["num_frames"] != frames:
        yield f"{folder.name}: num_frames is {metadata['num_frames']}, not {frames}"
    yield from _names(folder, {schema.METADATA_FILE, "rgb", "lowdim", *(["depth"] if depth else [])})
    yield from _names(folder / "rgb", set(cameras))
    for camera in cameras:
        images = {schema.frame_name(k, metadata["rgb"]["extension"]) for k in range(frames)}
        yield from _names(folder / "rgb" / camera, images | {schema.TIMESTAMPS_FILE})
        yield from _form(camera, np.load(folder / "rgb" / camera / schema.TIMESTAMPS_FILE), ("int64", (frames,)))
    for camera in (folder / "depth").iterdir() if depth else ():
        yield from _names(camera, {schema.frame_name(k, "npz") for k in range(frames)})
        for file in camera.iterdir():
            with np.load(file, allow_pickle=False) as archive:
                image = archive[schema.DEPTH_KEY]
                yield from _form(file.name, image, ("uint16", image.shape[:2]))
    yield from _names(folder / "lowdim", {schema.frame_name(k, "pkl") for k in range(frames)})
    for file in sorted((folder / "lowdim").iterdir()):
        yield from _frame(file, cameras, arms, width)


def _frame(file: Path, cameras: list[str], arms: int, width: int) -> Iterator[str]:
    frame = pickle.loads(file.read_bytes())
    wanted = dict(_FRAME) | ({schema.RIGHT_BASE_POSE_KEY: ("float32", (4, 4))} if arms == 2 else {})
    if list(frame) != list(wanted):
        yield f"{file.name}: keys are {list(frame)}, not {list(wanted)}"
    for key, (dtype, shape) in wanted.items():
        if key in _OF_CAMERAS and list(frame[key]) != cameras:
            yield f"{file.name}: {key} is of {list(frame[key])}, not of {cameras}"
        for value in frame[key].values() if key in _OF_CAMERAS else [frame[key]]:
            yield from _form(f"{file.name}: {key}", value, (dtype, (width * shape[0],) if len(shape) == 1 else shape))


def _form(where: str, value: Any, form: Form) -> Iterator[str]:
    found = (str(value.dtype), value.shape) if isinstance(value, np.ndarray) else (type(value).__name__, ())
    if found != form:
        yield f"{where} is {found[0]} {found[1]}, not {form[0]} {form[1]}"


def _names(folder: Path, wanted: set[str]) -> Iterator[str]:
    yield from _sets(f"{folder.name}/", {entry.name for entry in folder.iterdir()}, wanted)


def _keys(where: str, found: Mapping[str, Any], *wanted: str) -> Iterator[str]:
    paths = {
        f"{key}.{inner}" if inner else key
        for key, value in found.items()
        for inner in (value if isinstance(value, dict) and key != "resolution" else [""])
    }
    yield from _sets(f"{where}: ", paths, {key for keys in wanted for key in keys.split()})


def _sets(where: str, found: set[str], wanted: set[str]) -> Iterator[str]:
    for name in sorted(wanted ^ found):
        yield f"{where}{name} is {'missing' if name in wanted else 'too much'}"
