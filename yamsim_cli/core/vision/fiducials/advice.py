"""What would help to find a board, from measures of the photo."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ...boards.board_image import marker_cells
from ...geometry.board import Board
from ...geometry.camera import CameraModel
from ..lens import project_points
from .fitting.align import Alignment

Grey = NDArray[np.uint8]

# Limits within which nearly all boards are found. Source: `make bench-fiducials`.
_MOTION = 3.0  # px
_BLUR = 1.5  # px, sigma
_CONTRAST = 8.0  # times the noise
_CELL = 0.8  # px
_RANGE = 60.0  # grey levels, range below which a photo is dark or lacks contrast
_SOFT = 2.5  # px, sigma of the sharpest edge above which a photo is blurred
_SMOOTHED = 1.5  # px, sigma of the smoothing against noise before edges are measured
_ENDS = (0.5, 99.5)  # percentiles of a photo's range


@dataclass(frozen=True)
class Looks:
    """A board's appearance in a photo.

    Attributes:
        cell: the shorter side of a cell of the print, px.
        blur, motion: sigma and length, px.
        contrast: grey levels from black to white.
        noise: standard deviation, grey levels.
    """

    cell: float
    blur: float
    motion: float
    contrast: float
    noise: float


def looks_of(board: Board, camera: CameraModel, photo: NDArray[np.float32], fit: Alignment) -> Looks:
    """A board's appearance at a fitted pose in a photo (height, width)."""
    T = fit.T_ref_in_cam
    corners = project_points(camera, board.outer_corners() @ T[:3, :3].T + T[:3, 3])
    area = cv2.contourArea(corners.astype(np.float32))
    longer = max(float(np.linalg.norm(corners[a] - corners[b])) for a, b in ((0, 1), (1, 2), (2, 3), (3, 0)))
    across = board.width / board.marker_length * marker_cells(board).shape[1]
    left, top = np.maximum(corners.min(axis=0), 0).astype(int)
    right, bottom = np.ceil(corners.max(axis=0)).astype(int)
    part = photo[top : bottom + 1, left : right + 1]
    low, high = np.percentile(part, _ENDS) if part.size else (0.0, 0.0)
    shorter = area / max(longer, 1.0)
    return Looks(shorter / across, fit.smear.blur, fit.smear.length, float(high - low), fit.noise)


def advice_on(looks: Looks) -> tuple[str, ...]:
    """What would help a board with this appearance; empty if all measures are within the limits."""
    found = []
    if looks.motion > _MOTION:
        found.append(f"hold still (it is smeared by {looks.motion:.0f} px)")
    if looks.blur > _BLUR:
        found.append(f"focus (its blur is {looks.blur:.1f} px)")
    if looks.contrast < _CONTRAST * looks.noise:
        found.append(f"more light (its contrast is {looks.contrast:.0f} of 255, the noise {looks.noise:.0f})")
    if looks.cell < _CELL:
        found.append(
            f"come closer, look from less of a slant or use a higher resolution (a cell is {looks.cell:.1f} px)"
        )
    return tuple(found)


def advice_on_photo(grey: Grey) -> tuple[str, ...]:
    """What would help in a photo (height, width) in which nothing looks like a board."""
    low, high = np.percentile(grey[::2, ::2], _ENDS)
    found = []
    if high - low < _RANGE:
        found.append(f"more light or contrast (grey levels are {low:.0f} to {high:.0f} of 255)")
    if (blur := _least_blur(grey, float(high - low))) > _SOFT:
        found.append(f"focus or hold still (no edge is sharper than {blur:.1f} px)")
    return tuple(found) or ("bring the whole board into the photo, or come closer",)


def _least_blur(grey: Grey, contrast: float) -> float:
    """The approximate sigma (px) of a photo's sharpest edges, from their slope."""
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _SMOOTHED)
    across, down = cv2.Scharr(smooth, cv2.CV_32F, 1, 0) / 32, cv2.Scharr(smooth, cv2.CV_32F, 0, 1) / 32
    steepest = float(np.percentile(np.hypot(across, down)[::2, ::2], 99.9))
    blur = contrast / (math.sqrt(2 * math.pi) * max(steepest, 0.1))
    return math.sqrt(max(blur**2 - _SMOOTHED**2, 0.0))
