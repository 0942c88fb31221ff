"""Find a board's markers in a photo, and keep those that can belong to one board."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ...boards.board_image import dictionary_of
from ...geometry.board import Board
from ...geometry.camera import CameraModel
from ...geometry.se3 import Array
from ..lens import rays

Grey = NDArray[np.uint8]

# The detector's thresholds are made for markers of some 30 px and more: smaller photos are enlarged to this width.
_ENLARGE_TO = 1920
_MAX_ENLARGEMENT = 3

# Larger photos are made so large: the detector leaves out markers whose edge is less than 0.0075 of the photo's longer
# side (its `minMarkerPerimeterRate`), so those that it would read there have 30 px here.
_SHRINK_TO = 4096

# The detector's thresholds are made for grey levels that use their range: darker photos are stretched to it, but for
# their darkest and brightest thousandth.
_ENDS = (0.1, 99.9)
_WIDEST = 128.0

# Markers belong to one board when the board's middle that each predicts lies within this many marker edges.
_SAME_BOARD = 0.8


@dataclass(frozen=True)
class DetectedMarker:
    """One detected marker: its id, and its corners (4, 2) in pixels, clockwise from its own top left."""

    id: int
    corners: Array


@dataclass(frozen=True)
class Group:
    """Markers that lie as on one board: places in `board.ids`, and their corners (k, 4, 2) in pixels."""

    places: tuple[int, ...]
    corners: Array


def find_markers(grey: Grey, dictionaries: Sequence[str]) -> dict[str, list[DetectedMarker]]:
    """All markers of some dictionaries in a photo (height, width), duplicates included.

    Raises:
        ConfigError: OpenCV has no such dictionary.
    """
    sized, factor = _sized(grey)
    parameters = cv2.aruco.DetectorParameters()
    # Corners are only where the pose starts from; refining them one by one costs six times as much as finding them.
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    found = {}
    for name in dictionaries:
        detector = cv2.aruco.ArucoDetector(dictionary_of(name), parameters)
        corners, ids, _ = detector.detectMarkers(sized)
        # Without any, OpenCV 4 gives None, which its type hints do not know of.
        numbers = np.asarray(() if not corners else ids, dtype=int).ravel().tolist()
        found[name] = [
            DetectedMarker(number, (quad.reshape(4, 2).astype(np.float64) + 0.5) / factor - 0.5)
            for number, quad in zip(numbers, corners, strict=True)
        ]
    return found


def _sized(grey: Grey) -> tuple[Grey, Array]:
    """The photo as large as the detector likes it, and how many times as wide and as high (2,) as it was."""
    longer = max(grey.shape)
    if longer > _SHRINK_TO:
        size = tuple(round(side * _SHRINK_TO / longer) for side in grey.shape[::-1])
        shrunk = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        return _stretched(shrunk), np.array(size) / grey.shape[::-1]
    factor = min(_MAX_ENLARGEMENT, max(1, round(_ENLARGE_TO / longer)))
    grey = _stretched(grey)
    if factor > 1:
        grey = np.asarray(cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC), dtype=np.uint8)
    return grey, np.array([factor, factor], dtype=np.float64)


def _stretched(grey: Grey) -> Grey:
    low, high = np.percentile(grey, _ENDS)
    if high - low >= _WIDEST or high - low < 1:
        return grey
    stretched: Grey = np.clip((grey.astype(np.float32) - low) * (255 / (high - low)), 0, 255).astype(np.uint8)
    return stretched


def groups(markers: Sequence[DetectedMarker], board: Board, camera: CameraModel) -> list[Group]:
    """Markers of a board, put together by where each says the board's middle is; the largest group first.

    A second print of the same board, or a reading that is wrong, ends up in a group of its own.
    """
    place = {number: k for k, number in enumerate(board.ids)}
    ours = [marker for marker in markers if marker.id in place]
    corners = board.corners()
    middles = [_middle(marker, corners[place[marker.id]], camera) for marker in ours]
    clusters: list[list[int]] = []
    for k, (marker, (middle, edge)) in enumerate(zip(ours, middles, strict=True)):
        for cluster in clusters:
            centre = np.mean([middles[j][0] for j in cluster], axis=0)
            taken = {ours[j].id for j in cluster}
            if marker.id not in taken and np.linalg.norm(middle - centre) < _SAME_BOARD * edge:
                cluster.append(k)
                break
        else:
            clusters.append([k])
    clusters.sort(key=len, reverse=True)
    return [
        Group(tuple(place[ours[k].id] for k in cluster), np.array([ours[k].corners for k in cluster]))
        for cluster in clusters
    ]


def _middle(marker: DetectedMarker, corners: Array, camera: CameraModel) -> tuple[Array, float]:
    """Where (as a viewing ray) a marker alone says the board's middle is, and its edge in the same measure."""
    seen = rays(camera, marker.corners)
    # The perspective of one small marker is mostly noise; far from it, an affine map errs less.
    known = np.column_stack([corners[:, :2], np.ones(4)])
    affine, *_ = np.linalg.lstsq(known, seen, rcond=None)
    edge = float(np.linalg.norm(np.diff(seen, axis=0), axis=1).max())
    return affine[2], edge


def seen_ids(markers: Mapping[str, Sequence[DetectedMarker]]) -> list[int]:
    """Ids of all markers found, once each, in order: for a person who wonders why a board was not."""
    return sorted({marker.id for found in markers.values() for marker in found})
