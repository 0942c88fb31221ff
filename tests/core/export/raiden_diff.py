"""The layout of raiden as data, and the differences of an export from it."""

from __future__ import annotations

import json
import pickle
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from yamsim_cli.core.export import raiden_schema as schema


@dataclass(frozen=True)
class Form:
    """An array's dtype and shape, or a plain type and (); with `each` a dictionary camera -> such an array."""

    dtype: str
    shape: tuple[int, ...] = ()
    each: bool = False


_HAND = 3 + 9 + 1  # position, rotation row by row, and the gripper


def _lowdim(width: int, recorded: int) -> Mapping[str, Form]:
    """Key -> form of a frame's dictionary, in order; arrays hold `width` arms."""
    return {
        "intrinsics": Form("float32", (3, 3), each=True),
        "extrinsics": Form("float32", (4, 4), each=True),
        "joints": Form("float32", (schema.ARM * width,)),
        "action": Form("float32", (_HAND * width,)),
        "actual_poses": Form("float32", (_HAND * width,)),
        "action_joints": Form("float32", (schema.ARM * width,)),
        "language_task": Form("object"),
        "language_prompt": Form("object"),
        **({schema.BETWEEN_ARMS: Form("float32", (4, 4))} if recorded == 2 else {}),
    }


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


def differences(root: Path, *, arms: int = 1, single: bool = False) -> list[str]:
    """What is wrong with an export of so many arms, `single` in arrays of one, one text each."""
    return list(_dataset(root, arms, _lowdim(1 if single else 2, arms)))


def _dataset(root: Path, arms: int, lowdim: Mapping[str, Form]) -> Iterator[str]:
    split = json.loads((root / schema.SPLIT).read_text())
    yield from _keys(schema.SPLIT, split, SPLIT_KEYS)
    yield from _names(
        root, {schema.SPLIT, schema.SHARED_METADATA, schema.CALIBRATION, *split["files"]}, f"{root.name}/"
    )
    size = {"n_seqs": len(split["files"]), "n_samples": len(split["files"]), "n_frames": sum(split["files"].values())}
    if split["size"] != size:
        yield f"{schema.SPLIT}: size is {split['size']}, not {size}"
    if list(split["files"]) != [schema.episode_name(k) for k in range(len(split["files"]))]:
        yield f"{schema.SPLIT}: episodes are {list(split['files'])}"
    for name, frames in split["files"].items():
        yield from _episode(root / name, frames, lowdim)
    first = root / next(iter(split["files"])) / schema.METADATA
    if (root / schema.SHARED_METADATA).read_bytes() != first.read_bytes():
        yield f"{schema.SHARED_METADATA} is not that of the first episode"
    yield from _calibration(root, json.loads(first.read_text())["cameras"], arms)


def _episode(folder: Path, frames: int, lowdim: Mapping[str, Form]) -> Iterator[str]:
    metadata = json.loads((folder / schema.METADATA).read_text())
    depth = "depth" in metadata["labels"]
    keys = {**METADATA_KEYS, **(DEPTH_METADATA_KEYS if depth else {})}
    if metadata["pictures"]["source"] == "nearest":
        keys |= NEAREST_METADATA_KEYS
    yield from _keys(f"{folder.name}/{schema.METADATA}", metadata, keys)
    if metadata["num_frames"] != frames:
        yield f"{folder.name}: num_frames is {metadata['num_frames']}, not {frames}"
    cameras = metadata["cameras"]
    yield from _names(folder, {schema.METADATA, "rgb", "lowdim", *(["depth"] if depth else [])})
    yield from _names(folder / "rgb", set(cameras))
    for camera in cameras:
        images = {schema.frame_name(k, metadata["rgb"]["extension"]) for k in range(frames)}
        yield from _names(folder / "rgb" / camera, images | {schema.TIMESTAMPS_FILE})
        yield from _form(
            f"{camera}/{schema.TIMESTAMPS_FILE}",
            np.load(folder / "rgb" / camera / "timestamps.npy"),
            Form("int64", (frames,)),
        )
    for file in folder.glob("depth/*/*"):
        with np.load(file, allow_pickle=False) as archive:
            if archive.files != [schema.DEPTH_KEY]:
                yield f"{file.name} holds {archive.files}"
            yield from _form(file.name, archive[schema.DEPTH_KEY], Form("uint16", (-1, -1)))
    for camera in (folder / "depth").iterdir() if depth else ():
        yield from _names(camera, {schema.frame_name(k, "npz") for k in range(frames)})
    yield from _names(folder / "lowdim", {schema.frame_name(k, "pkl") for k in range(frames)})
    for file in sorted((folder / "lowdim").iterdir()):
        yield from _frame(file, cameras, lowdim)


def _frame(file: Path, cameras: list[str], lowdim: Mapping[str, Form]) -> Iterator[str]:
    frame = pickle.loads(file.read_bytes())
    if list(frame) != list(lowdim):
        yield f"{file.name}: keys are {list(frame)}, not {list(lowdim)}"
    for key, form in lowdim.items():
        values = frame[key] if form.each else {"": frame[key]}
        if form.each and list(values) != cameras:
            yield f"{file.name}: {key} is of {list(values)}, not of {cameras}"
        for value in values.values():
            yield from _form(f"{file.name}: {key}", value, form)


def _calibration(root: Path, cameras: list[str], arms: int) -> Iterator[str]:
    calibration = json.loads((root / schema.CALIBRATION).read_text())
    on_top = BIMANUAL_CALIBRATION_KEYS if arms == 2 else {}
    yield from _keys(schema.CALIBRATION, calibration, {**CALIBRATION_KEYS, **on_top})
    if list(calibration["cameras"]) != cameras:
        yield f"{schema.CALIBRATION}: cameras are {list(calibration['cameras'])}"
    for name, entry in calibration["cameras"].items():
        keys = WRIST_CAMERA_KEYS if entry["type"] == "hand_eye" else SCENE_CAMERA_KEYS
        yield from _keys(f"{schema.CALIBRATION}: {name}", entry, keys)


def _form(where: str, value: Any, form: Form) -> Iterator[str]:
    if isinstance(value, np.ndarray):
        found, shape = str(value.dtype), value.shape
        fits = len(shape) == len(form.shape) and all(b in (-1, a) for a, b in zip(shape, form.shape, strict=True))
    else:
        found, shape, fits = type(value).__name__, (), form.shape == ()
    if found != form.dtype or not fits:
        yield f"{where} is {found} {shape}, not {form.dtype} {form.shape}"


def _names(folder: Path, wanted: set[str], where: str | None = None) -> Iterator[str]:
    found = {entry.name for entry in folder.iterdir()}
    for name in sorted(wanted - found):
        yield f"{where or folder.name + '/'}{name} is missing"
    for name in sorted(found - wanted):
        yield f"{where or folder.name + '/'}{name} is too much"


def _keys(where: str, found: Mapping[str, Any], wanted: Keys) -> Iterator[str]:
    for name in sorted(wanted.keys() - found.keys()):
        yield f"{where}: {name} is missing"
    for name in sorted(found.keys() - wanted.keys()):
        yield f"{where}: {name} is too much"
    for name, inner in wanted.items():
        if inner is not None and isinstance(found.get(name), dict):
            yield from _keys(f"{where}: {name}", found[name], inner)
