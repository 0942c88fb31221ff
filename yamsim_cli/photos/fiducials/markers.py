"""Detect ArUco markers, and group those that can belong to one print of a board."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from yamsim_cli.camera_effects.lens_distortion import viewing_rays
from yamsim_cli.core.geometry.board import Board
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.images.board_image import aruco_dictionary

Grey = NDArray[np.uint8]

_ENLARGED_PHOTO_SIDE = 1920  # px, longer side of enlarged small photos: the detector suits markers of 30 px and more
_MAX_ENLARGEMENT = 3
# px, longer side to which larger photos are reduced. The detector ignores markers with an edge below 0.0075 of the
# longer side (`minMarkerPerimeterRate`), which is 30 px after the reduction.
REDUCED_SIDE = 4096
# The detector's thresholds suit photos that use all grey levels.
_STRETCHED_PERCENTILES = (0.1, 99.9)  # percentiles that are stretched to the whole range
_MIN_UNSTRETCHED_RANGE = 128.0  # grey levels; photos with a larger range are not stretched
_MAX_CENTRE_DISTANCE = 0.8  # marker edges, between the board centres that two markers predict


@dataclass(frozen=True)
class DetectedMarker:
    """Id, and corners (4, 2), px, clockwise from the marker's own top left."""

    id: int
    corners: Array


@dataclass(frozen=True)
class MarkerGroup:
    """Markers that can belong to one board: indices into `board.ids`, corners (k, 4, 2), px."""

    places: tuple[int, ...]
    corners: Array


def find_markers(grey: Grey, dictionaries: Sequence[str]) -> dict[str, list[DetectedMarker]]:
    """Return the markers of each dictionary in a photo (height, width), with repeated ids.

    Raises:
        ConfigError: OpenCV has no such dictionary.
    """
    sized, factor = _resize_for_detector(grey)
    parameters = cv2.aruco.DetectorParameters()
    # Start values only; refinement would take six times the detection.
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    found = {}
    for name in dictionaries:
        detector = cv2.aruco.ArucoDetector(aruco_dictionary(name), parameters)
        corners, ids, _ = detector.detectMarkers(sized)
        # OpenCV 4 returns None for no markers.
        numbers = np.asarray(() if not corners else ids, dtype=int).ravel().tolist()
        found[name] = [
            DetectedMarker(number, (quad.reshape(4, 2).astype(np.float64) + 0.5) / factor - 0.5)
            for number, quad in zip(numbers, corners, strict=True)
        ]
    return found


def _resize_for_detector(grey: Grey) -> tuple[Grey, Array]:
    longer = max(grey.shape)
    if longer > REDUCED_SIDE:
        size = tuple(round(side * REDUCED_SIDE / longer) for side in grey.shape[::-1])
        shrunk = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        return stretch_contrast(shrunk), np.array(size) / grey.shape[::-1]
    factor = min(_MAX_ENLARGEMENT, max(1, round(_ENLARGED_PHOTO_SIDE / longer)))
    grey = stretch_contrast(grey)
    if factor > 1:
        grey = np.asarray(cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC), dtype=np.uint8)
    return grey, np.array([factor, factor], dtype=np.float64)


def stretch_contrast(grey: Grey) -> Grey:
    """Return the photo (height, width) with grey levels spread over 0..255; unchanged if its contrast suffices."""
    low, high = np.percentile(grey, _STRETCHED_PERCENTILES)
    if high - low >= _MIN_UNSTRETCHED_RANGE or high - low < 1:
        return grey
    stretched: Grey = np.clip((grey.astype(np.float32) - low) * (255 / (high - low)), 0, 255).astype(np.uint8)
    return stretched


def group_markers(markers: Sequence[DetectedMarker], board: Board, camera: CameraModel) -> list[MarkerGroup]:
    """Group a board's markers by the board centre that each predicts, largest group first.

    A second print, or a misread marker, forms another group.
    """
    place = {number: k for k, number in enumerate(board.marker_ids)}
    ours = [marker for marker in markers if marker.id in place]
    corners = board.marker_corners()
    middles = [_predicted_board_centre(marker, corners[place[marker.id]], camera) for marker in ours]
    clusters: list[list[int]] = []
    for k, (marker, (middle, edge)) in enumerate(zip(ours, middles, strict=True)):
        for cluster in clusters:
            centre = np.mean([middles[j][0] for j in cluster], axis=0)
            taken = {ours[j].id for j in cluster}
            if marker.id not in taken and np.linalg.norm(middle - centre) < _MAX_CENTRE_DISTANCE * edge:
                cluster.append(k)
                break
        else:
            clusters.append([k])
    clusters.sort(key=len, reverse=True)
    return [
        MarkerGroup(tuple(place[ours[k].id] for k in cluster), np.array([ours[k].corners for k in cluster]))
        for cluster in clusters
    ]


def _predicted_board_centre(marker: DetectedMarker, corners: Array, camera: CameraModel) -> tuple[Array, float]:
    """Return the viewing ray (2,) of the predicted board centre, and the marker's edge in ray units."""
    seen = viewing_rays(camera, marker.corners)
    # A small marker's perspective is mostly noise: an affine map extrapolates better.
    known = np.column_stack([corners[:, :2], np.ones(4)])
    affine, *_ = np.linalg.lstsq(known, seen, rcond=None)
    edge = float(np.linalg.norm(np.diff(seen, axis=0), axis=1).max())
    return affine[2], edge


def sorted_marker_ids(markers: Mapping[str, Sequence[DetectedMarker]]) -> list[int]:
    """Return the sorted ids of all markers, once each."""
    return sorted({marker.id for found in markers.values() for marker in found})
