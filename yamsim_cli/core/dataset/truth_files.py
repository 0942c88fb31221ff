"""Ground truth beside a recording's images: what it holds, in which shapes, and what is wrong with it.

One archive a camera holds all frames' numbers, rather than a file each: half the files, and one array to slice. Labels
and names are JSON. Depth and segmentation are images, and so one file a frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import DatasetError
from .arrays import dump_arrays, load_arrays
from .records import Record

# A point counts as seen where the depth image differs from it by no more than this, m.
DEPTH_TOLERANCE = 0.002
# A joint's centre lies inside the arm, under no more than this much of it. Source: the motors' housings are 66 mm wide
# and up to 100 mm long.
JOINT_COVER = 0.07

BACKGROUND = 0


class Visibility(IntEnum):
    """Of a keypoint, in COCO's numbers."""

    OUTSIDE = 0
    HIDDEN = 1
    VISIBLE = 2


class LabelRecord(Record):
    """What one number in a segmentation image stands for: a link or another body, and the thing it is part of."""

    id: int
    name: str
    instance: str


class KeypointRecord(Record):
    """A point whose place in the image is known.

    Attributes:
        body: of which it is part: a link or a board.
        kind: "joint" is the centre of a joint, inside the arm; "axis" is where a joint's axis leaves the surface;
            "corner" is a corner of a board's print.
    """

    name: str
    body: str
    kind: Literal["joint", "axis", "corner"]


class TruthLabels(Record):
    """`truth/labels.json`: names for the axes of the arrays in `truth/<camera>.npz`, and for segmentation's numbers.

    Attributes:
        instances: whose boxes there are.
        links, objects: whose poses there are.
        keypoints: in the arrays' order.
        depth_tolerance_m: within which the depth image has to agree for a point on a surface to count as visible.
        joint_cover_m: by how much of its own links a joint's centre may be covered and still count as visible.
    """

    labels: list[LabelRecord]
    instances: list[str]
    links: list[str]
    objects: list[str]
    keypoints: list[KeypointRecord]
    depth_tolerance_m: float = DEPTH_TOLERANCE
    joint_cover_m: float = JOINT_COVER


# Key -> dtype and shape; T frames, and the lengths of the labels' lists.
ARRAYS: Mapping[str, tuple[type[np.generic], tuple[int | str, ...]]] = {
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

# No more than a camera's numbers of hours of recording.
_MOST_ARRAYS = 2**28
_MOST_DEPTH = 2**27


def array_shapes(labels: TruthLabels, frames: int) -> dict[str, tuple[int, ...]]:
    """Key -> shape of the arrays of one camera."""
    lengths = {
        "frames": frames,
        "links": len(labels.links),
        "objects": len(labels.objects),
        "keypoints": len(labels.keypoints),
        "instances": len(labels.instances),
    }
    return {
        key: tuple(lengths[part] if isinstance(part, str) else part for part in shape)
        for key, (_, shape) in ARRAYS.items()
    }


def array_faults(arrays: Mapping[str, NDArray[Any]], labels: TruthLabels, frames: int) -> list[str]:
    """What is wrong with the arrays of one camera."""
    faults = []
    for key, shape in array_shapes(labels, frames).items():
        array, dtype = arrays.get(key), np.dtype(ARRAYS[key][0])
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
    """Read a depth image back.

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
    """Read the arrays of one camera back.

    Raises:
        DatasetError: they are damaged.
    """
    return load_arrays(data, _MOST_ARRAYS)
