"""An export held against `raiden_schema`: everything that is missing, too much, or of another form."""

from __future__ import annotations

import json
import pickle
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from yamsim_cli.core.export import raiden_schema as schema


def differences(root: Path, *, arms: int = 1, single: bool = False) -> list[str]:
    """What is wrong with an export of so many arms, `single` in arrays of one, one text each."""
    return list(_dataset(root, arms, schema.lowdim(1 if single else 2, arms)))


def _dataset(root: Path, arms: int, lowdim: Mapping[str, schema.RaidenForm]) -> Iterator[str]:
    split = json.loads((root / schema.SPLIT).read_text())
    yield from _keys(schema.SPLIT, split, schema.SPLIT_KEYS)
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


def _episode(folder: Path, frames: int, lowdim: Mapping[str, schema.RaidenForm]) -> Iterator[str]:
    metadata = json.loads((folder / schema.METADATA).read_text())
    depth = "depth" in metadata["labels"]
    keys = {**schema.METADATA_KEYS, **(schema.DEPTH_METADATA_KEYS if depth else {})}
    if metadata["pictures"]["source"] == "nearest":
        keys |= schema.NEAREST_METADATA_KEYS
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
            schema.RaidenForm(schema.TIMESTAMPS.dtype, (frames,)),
        )
    for file in folder.glob("depth/*/*"):
        with np.load(file, allow_pickle=False) as archive:
            if archive.files != [schema.DEPTH_KEY]:
                yield f"{file.name} holds {archive.files}"
            yield from _form(file.name, archive[schema.DEPTH_KEY], schema.DEPTH)
    for camera in (folder / "depth").iterdir() if depth else ():
        yield from _names(camera, {schema.frame_name(k, "npz") for k in range(frames)})
    yield from _names(folder / "lowdim", {schema.frame_name(k, "pkl") for k in range(frames)})
    for file in sorted((folder / "lowdim").iterdir()):
        yield from _frame(file, cameras, lowdim)


def _frame(file: Path, cameras: list[str], lowdim: Mapping[str, schema.RaidenForm]) -> Iterator[str]:
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
    on_top = schema.BIMANUAL_CALIBRATION_KEYS if arms == 2 else {}
    yield from _keys(schema.CALIBRATION, calibration, {**schema.CALIBRATION_KEYS, **on_top})
    if list(calibration["cameras"]) != cameras:
        yield f"{schema.CALIBRATION}: cameras are {list(calibration['cameras'])}"
    for name, entry in calibration["cameras"].items():
        keys = schema.WRIST_CAMERA_KEYS if entry["type"] == "hand_eye" else schema.SCENE_CAMERA_KEYS
        yield from _keys(f"{schema.CALIBRATION}: {name}", entry, keys)


def _form(where: str, value: Any, form: schema.RaidenForm) -> Iterator[str]:
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


def _keys(where: str, found: Mapping[str, Any], wanted: schema.Keys) -> Iterator[str]:
    for name in sorted(wanted.keys() - found.keys()):
        yield f"{where}: {name} is missing"
    for name in sorted(found.keys() - wanted.keys()):
        yield f"{where}: {name} is too much"
    for name, inner in wanted.items():
        if inner is not None and isinstance(found.get(name), dict):
            yield from _keys(f"{where}: {name}", found[name], inner)
