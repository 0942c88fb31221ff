"""Ground truth files: content, shapes and validation.

One `.npz` archive per camera holds the arrays of all frames. Labels and names are JSON. Depth and segmentation are
images, with one file per frame. Equal arrays give equal archive bytes. Archives of unknown origin are safe to read.
"""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Mapping
from enum import IntEnum
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..errors import DatasetError
from .records import Record

DEPTH_TOLERANCE = 0.002  # m, largest difference between the depth image and the depth of a visible point
# m. A joint counts as visible if its centre lies at most this far behind the visible surface of its arm. The centre is
# inside a motor housing, which is 66 mm wide and up to 100 mm long.
JOINT_COVER_RADIUS = 0.07

BACKGROUND = 0  # segmentation value of pixels that show no labelled body


class Visibility(IntEnum):
    """Visibility of a keypoint, with the values of the COCO format."""

    OUTSIDE = 0
    HIDDEN = 1
    VISIBLE = 2


class LabelRecord(Record):
    """Meaning of one segmentation value: a link or other body, and the instance that contains the body."""

    id: int
    name: str
    instance: str


class KeypointRecord(Record):
    """A keypoint of a link, a calibration board or a cloth.

    Attributes:
        body: name of the link, board or cloth that has the keypoint.
        kind: "joint" is the centre of a joint, inside the arm. "axis" is the point where a joint axis leaves the
            surface. "corner" is a corner of the print on a board. "cloth" is a corner of a cloth.
    """

    name: str
    body: str
    kind: Literal["joint", "axis", "corner", "cloth"]


class TruthLabels(Record):
    """`truth/labels.json`: names for the array axes of `truth/<camera>.npz`, and for segmentation values.

    Attributes:
        labels: the segmentation values.
        instances: names of those with boxes.
        links, objects: names of those with poses.
        keypoints: in array order.
        cloths: cloth -> number of points along its x axis and its y axis.
        depth_tolerance_m, joint_cover_m: `DEPTH_TOLERANCE` and `JOINT_COVER_RADIUS` at recording time, m.
    """

    labels: list[LabelRecord]
    instances: list[str]
    links: list[str]
    objects: list[str]
    keypoints: list[KeypointRecord]
    # Omitted if empty: `verify` compares the bytes of this file.
    cloths: dict[str, tuple[int, int]] = Field(default_factory=dict, exclude_if=lambda cloths: not cloths)
    depth_tolerance_m: float = DEPTH_TOLERANCE
    joint_cover_m: float = JOINT_COVER_RADIUS


# Array key -> dtype and shape. "frames" in a shape is the number of frames. Any other name is the length of the list
# with that name in `TruthLabels`.
_ARRAY_TYPES_AND_SHAPES: Mapping[str, tuple[type[np.generic], tuple[int | str, ...]]] = {
    "intrinsics": (np.float64, (3, 3)),
    "T_cam_in_base": (np.float32, ("frames", 4, 4)),
    "T_link_in_cam": (np.float32, ("frames", "links", 4, 4)),
    "T_object_in_cam": (np.float32, ("frames", "objects", 4, 4)),
    "keypoints": (np.float32, ("frames", "keypoints", 2)),
    "keypoint_depth": (np.float32, ("frames", "keypoints")),
    "visibility": (np.uint8, ("frames", "keypoints")),
    "boxes": (np.int32, ("frames", "instances", 4)),
    "pixels": (np.int32, ("frames", "instances")),
}

_MAX_ARRAY_BYTES = 2**28  # largest total size of a camera's arrays that is read: enough for hours of recording
_MAX_DEPTH_BYTES = 2**27  # largest size of a depth image that is read


def visible_points_key(cloth: str) -> str:
    """Return the key of the boolean array (frames, points) that states which points of a cloth are visible."""
    return f"{cloth}_visible"


def array_specs(labels: TruthLabels, frames: int) -> dict[str, tuple[np.dtype[Any], tuple[int, ...]]]:
    """Return key -> required dtype and shape, for the arrays of one camera in an episode with `frames` frames."""
    lists = ("links", "objects", "keypoints", "instances")
    lengths = {"frames": frames} | {name: len(getattr(labels, name)) for name in lists}
    forms = {
        key: (np.dtype(dtype), tuple(lengths[part] if isinstance(part, str) else part for part in shape))
        for key, (dtype, shape) in _ARRAY_TYPES_AND_SHAPES.items()
    }
    return forms | {
        visible_points_key(cloth): (np.dtype(np.bool_), (frames, columns * rows))
        for cloth, (columns, rows) in labels.cloths.items()
    }


def array_faults(arrays: Mapping[str, NDArray[Any]], labels: TruthLabels, frames: int) -> list[str]:
    """Compare the arrays of one camera with `array_specs`, and return one text per missing or invalid array."""
    faults = []
    for key, (dtype, shape) in array_specs(labels, frames).items():
        array = arrays.get(key)
        if array is None:
            faults.append(f"{key} is missing")
        elif array.dtype != dtype or array.shape != shape:
            faults.append(f"{key} is {array.dtype} {array.shape}, not {dtype} {shape}")
        elif not np.isfinite(array).all():
            faults.append(f"{key} has values that are not finite")
    return faults


def dump_depth(depth_mm: NDArray[np.uint16]) -> bytes:
    """Encode a depth image (height, width) in mm as `.npz` bytes, as in recordings of the program raiden."""
    return dump_arrays({"depth": depth_mm})


def load_depth(data: bytes) -> NDArray[np.uint16]:
    """Read a depth image (height, width) in mm from an `.npz`. Raise DatasetError for damaged data or another dtype."""
    depth = load_arrays(data, _MAX_DEPTH_BYTES).get("depth")
    if depth is None:
        raise DatasetError("it has no array `depth`")
    if depth.dtype != np.uint16 or depth.ndim != 2:
        raise DatasetError(f"depth is {depth.dtype} {depth.shape}, not uint16 (height, width)")
    return depth


def load_truth(data: bytes) -> dict[str, NDArray[Any]]:
    """Decode the arrays of one camera from an `.npz`. Raise DatasetError if it is damaged, too large or not numeric."""
    return load_arrays(data, _MAX_ARRAY_BYTES)


_ZIP_DATE = (1980, 1, 1, 0, 0, 0)  # earliest date that a zip file can hold
# zlib level. Measured on depth images of 640 x 480: level 1 gives 25.0 kB in 1.1 ms, 4 gives 20.7 kB in 2.1 ms,
# 6 gives 19.4 kB in 3.1 ms, and 9 gives 18.2 kB in 4.2 ms.
_ZIP_LEVEL = 4
_MAX_NPY_HEADER = 4096  # bytes, longest `.npy` header that is read

Arrays = Mapping[str, NDArray[Any]]


def dump_arrays(arrays: Arrays) -> bytes:
    """Encode arrays as `.npz` bytes that `numpy.load` can read. Equal arrays in equal order give equal bytes."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=_ZIP_LEVEL) as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy", _ZIP_DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            content = io.BytesIO()
            np.lib.format.write_array(content, np.ascontiguousarray(array), version=(1, 0), allow_pickle=False)
            archive.writestr(entry, content.getvalue(), compresslevel=_ZIP_LEVEL)
    return stream.getvalue()


def load_arrays(data: bytes, maximum: int) -> dict[str, NDArray[Any]]:
    """Decode an `.npz` from an untrusted source, and return name -> array. Only arrays of numbers are accepted.

    Args:
        maximum: largest total size of the arrays, bytes. An archive that declares a larger size is not read.

    Raises:
        DatasetError: the archive is damaged, too large, or holds data other than numbers.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = archive.infolist()
            if (size := sum(entry.file_size for entry in entries)) <= maximum:
                return {entry.filename.removesuffix(".npy"): _decode_array(archive.read(entry)) for entry in entries}
    # The zip and npy readers can raise almost any exception on a damaged archive.
    except Exception as error:
        reason = " ".join(str(error).split())[:200]
        raise DatasetError(f"not a valid npz file: {type(error).__name__}: {reason}") from error
    raise DatasetError(f"it holds {size} bytes; at most {maximum} are read")


def _decode_array(data: bytes) -> NDArray[Any]:
    """Read the array in an `.npy` without allocating more memory than its data has."""
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    if version == (1, 0):
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream, _MAX_NPY_HEADER)
    elif version == (2, 0):
        shape, fortran, dtype = np.lib.format.read_array_header_2_0(stream, _MAX_NPY_HEADER)
    else:
        raise ValueError(f"version {version} of npy is not supported")
    if dtype.kind not in "biuf":
        raise ValueError(f"an array of {dtype} holds no numbers")
    content = data[stream.tell() :]
    if math.prod(shape) * dtype.itemsize != len(content):
        raise ValueError(f"{len(content)} bytes do not make an array of {dtype} with shape {shape}")
    flat = np.frombuffer(content, dtype)
    return flat.reshape(shape, order="F" if fortran else "C")
