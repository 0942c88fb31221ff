"""Ground truth beside a recording's images: its content, its shapes, and its faults.

An archive per camera holds the numbers of all frames. That halves the number of files, and gives arrays to slice.
Labels and names are JSON. Depth and segmentation are images, with one file per frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..errors import DatasetError
from .arrays import dump_arrays, load_arrays
from .records import Record

# A point on a surface counts as visible if the depth image differs from its depth by no more than this, m.
DEPTH_TOLERANCE = 0.002
# A joint's centre lies inside the arm. It counts as visible if its own links cover it by no more than this, m. Source:
# the motors' housings are 66 mm wide and up to 100 mm long.
JOINT_COVER = 0.07

BACKGROUND = 0


class Visibility(IntEnum):
    """A keypoint's visibility, in COCO's numbers."""

    OUTSIDE = 0
    HIDDEN = 1
    VISIBLE = 2


class LabelRecord(Record):
    """The meaning of one number in a segmentation image: a link or another body, and the thing that it is part of."""

    id: int
    name: str
    instance: str


class KeypointRecord(Record):
    """A point whose place in the image is known.

    Attributes:
        body: the link, board or cloth that it is part of.
        kind: "joint" is the centre of a joint, inside the arm; "axis" is where a joint's axis leaves the surface;
            "corner" is a corner of a board's print, "cloth" one of a cloth.
    """

    name: str
    body: str
    kind: Literal["joint", "axis", "corner", "cloth"]


class TruthLabels(Record):
    """`truth/labels.json`: names for the axes of the arrays in `truth/<camera>.npz`, and for segmentation's numbers.

    Attributes:
        instances: names of the things that have boxes.
        links, objects: names of the links and objects that have poses.
        keypoints: the keypoints, in the arrays' order.
        cloths: cloth -> how many points lie along its x axis and along its y axis; left out where there are none.
        depth_tolerance_m: how much the depth image may differ from the depth of a visible point on a surface, m.
        joint_cover_m: how much of its own links may cover the centre of a visible joint, m.
    """

    labels: list[LabelRecord]
    instances: list[str]
    links: list[str]
    objects: list[str]
    keypoints: list[KeypointRecord]
    cloths: Annotated[dict[str, tuple[int, int]], Field(exclude_if=lambda cloths: not cloths)] = Field(
        default_factory=dict
    )
    depth_tolerance_m: float = DEPTH_TOLERANCE
    joint_cover_m: float = JOINT_COVER


# Key -> dtype and shape, in which a name stands for the number of frames or the length of a list in the labels.
_ARRAYS: Mapping[str, tuple[type[np.generic], tuple[int | str, ...]]] = {
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

# Bytes of the largest arrays of a camera that are read, which is enough for hours of recording.
_MOST_ARRAYS = 2**28
# Bytes of the largest depth image that is read.
_MOST_DEPTH = 2**27


def visible_name(cloth: str) -> str:
    """The key of the array that says which points of a cloth are visible."""
    return f"{cloth}_visible"


def array_forms(labels: TruthLabels, frames: int) -> dict[str, tuple[np.dtype[Any], tuple[int, ...]]]:
    """Key -> dtype and shape of the arrays of one camera."""
    lengths = {
        "frames": frames,
        "links": len(labels.links),
        "objects": len(labels.objects),
        "keypoints": len(labels.keypoints),
        "instances": len(labels.instances),
    }
    forms = {
        key: (np.dtype(dtype), tuple(lengths[part] if isinstance(part, str) else part for part in shape))
        for key, (dtype, shape) in _ARRAYS.items()
    }
    return forms | {
        visible_name(cloth): (np.dtype(np.bool_), (frames, columns * rows))
        for cloth, (columns, rows) in labels.cloths.items()
    }


def array_faults(arrays: Mapping[str, NDArray[Any]], labels: TruthLabels, frames: int) -> list[str]:
    """The faults of one camera's arrays."""
    faults = []
    for key, (dtype, shape) in array_forms(labels, frames).items():
        array = arrays.get(key)
        if array is None:
            faults.append(f"{key} is missing")
        elif array.dtype != dtype or array.shape != shape:
            faults.append(f"{key} is {array.dtype} {array.shape}, not {dtype} {shape}")
        elif not np.isfinite(array).all():
            faults.append(f"{key} has values that are not finite")
    return faults


def dump_depth(depth_mm: NDArray[np.uint16]) -> bytes:
    """A depth image (height, width) in mm as an `.npz`, as raiden's recordings have it."""
    return dump_arrays({"depth": depth_mm})


def load_depth(data: bytes) -> NDArray[np.uint16]:
    """The depth image (height, width) in mm in an `.npz`.

    Raises:
        DatasetError: it is damaged, or is no image of uint16.
    """
    depth = load_arrays(data, _MOST_DEPTH).get("depth")
    if depth is None:
        raise DatasetError("it has no array `depth`")
    if depth.dtype != np.uint16 or depth.ndim != 2:
        raise DatasetError(f"depth is {depth.dtype} {depth.shape}, not uint16 (height, width)")
    return depth


def load_truth(data: bytes) -> dict[str, NDArray[Any]]:
    """The arrays of one camera, by the keys of `array_forms`.

    Raises:
        DatasetError: they are damaged.
    """
    return load_arrays(data, _MOST_ARRAYS)
