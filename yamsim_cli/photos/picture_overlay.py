"""Draw rendered arms, boards and text over a photo."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from yamsim_cli.camera_effects.lens_distortion import project_points

from ..core.geometry.board import Board
from ..core.geometry.camera import CameraModel
from ..core.geometry.se3 import Array
from ..core.images.image import Image

Labels = NDArray[np.uint8]

# RGB of arms, also with red-green blindness, and axes.
ARM_COLOURS = ((255, 176, 0), (0, 170, 255))
_AXIS_COLOURS = ((230, 40, 40), (40, 180, 60), (50, 90, 240))
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_MIN_SCALE = 0.2  # font scale; smaller text is unreadable
_FRACTION_BITS = 4  # fractional bits of pixel coordinates in OpenCV's drawing


def blend_arms(photo: Image, rendered: Image, labels: Labels, opacity: float) -> Image:
    """Blend rendered arms into a photo (height, width, 3), each with its colour as outline.

    Args:
        labels: (height, width): 0 background, k the k-th arm.
        opacity: of the arms, 0..1.
    """
    mixed = photo.astype(np.float32)
    on = labels > 0
    mixed[on] += opacity * (rendered[on].astype(np.float32) - mixed[on])
    result = np.round(mixed).astype(np.uint8)
    thickness = max(1, round(max(photo.shape) / 640))
    for k, colour in enumerate(ARM_COLOURS, start=1):
        contours, _ = cv2.findContours((labels == k).astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(result, contours, -1, colour, thickness, cv2.LINE_AA)
    return result


def draw_board(image: Image, camera: CameraModel, board: Board, T_board_in_cam: Array) -> None:
    """Draw a board's edge and axes (x red, y green, z blue, half a board width), in place."""
    half_x, half_y = board.width / 2, board.height / 2
    edge = np.array([[-half_x, half_y, 0], [half_x, half_y, 0], [half_x, -half_y, 0], [-half_x, -half_y, 0]])
    axes = np.array([[0, 0, 0], [half_x, 0, 0], [0, half_x, 0], [0, 0, half_x]])
    in_cam = np.concatenate([edge, axes]) @ T_board_in_cam[:3, :3].T + T_board_in_cam[:3, 3]
    if (in_cam[:, 2] <= 1e-3).any():
        return
    pixels = np.round(project_points(camera, in_cam) * 2**_FRACTION_BITS).astype(np.int32)
    thickness = max(1, round(max(image.shape) / 480))
    cv2.polylines(image, [pixels[:4]], True, (255, 255, 255), thickness, cv2.LINE_AA, _FRACTION_BITS)
    for end, colour in zip(pixels[5:], _AXIS_COLOURS, strict=True):
        cv2.line(image, pixels[4].tolist(), end.tolist(), colour, thickness + 1, cv2.LINE_AA, _FRACTION_BITS)


def write_lines(image: Image, lines: Sequence[str], busy: NDArray[np.bool_]) -> None:
    """Write text in the corner with the fewest `busy` (height, width) pixels, in place."""
    if not lines:
        return
    height, width = image.shape[:2]
    scale = max(0.38, max(height, width) / 1700)
    thickness = max(1, round(1.2 * scale))
    # Smaller fonts are tried until the text fits: OpenCV rounds text sizes to whole pixels.
    while True:
        widest = max(cv2.getTextSize(line, _FONT, scale, thickness)[0][0] for line in lines)
        row, pad = round(38 * scale), round(12 * scale)
        size = (len(lines) * row + 2 * pad, widest + 2 * pad)
        if scale < _MIN_SCALE or (size[0] <= height and size[1] <= width):
            break
        scale *= 0.9
    top, left = _least_busy_corner(busy, size)
    plate = image[top : top + size[0], left : left + size[1]]
    plate[:] = (plate * 0.35).astype(np.uint8)
    for k, line in enumerate(lines, start=1):
        at = (left + pad, top + pad + k * row - round(12 * scale))
        cv2.putText(image, line, at, _FONT, scale, (255, 255, 255), thickness, cv2.LINE_AA)


def _least_busy_corner(busy: NDArray[np.bool_], size: tuple[int, int]) -> tuple[int, int]:
    """Return the top left of the corner area of `size` (rows, columns) with the fewest busy pixels."""
    rows, columns = min(size[0], busy.shape[0]), min(size[1], busy.shape[1])
    corners = [(top, left) for top in (0, busy.shape[0] - rows) for left in (0, busy.shape[1] - columns)]
    return min(corners, key=lambda at: int(busy[at[0] : at[0] + rows, at[1] : at[1] + columns].sum()))
