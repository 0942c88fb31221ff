"""The focal length of a camera nobody calibrated, from the boards in its photo: as good as their perspective tells it.

A board seen at a slant shrinks towards its far edge, and how much so tells its distance apart from its size in the
picture. Seen straight on it does not; then only what lenses usually are is left, and the result's uncertainty says so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...geometry.board import Board
from ...geometry.camera import CameraModel
from .align import Guess, align
from .locate import INFLATION, Sighting, Status, locate
from .print_view import Piece

Grey = NDArray[np.uint8]

# What lenses usually are: a horizontal field of view of 60 degrees, and the spread of ln(focal) from phones to webcams.
_USUAL = 0.5 / math.tan(math.radians(30.0))
_USUAL_SPREAD = 0.35

# However many boards are seen, lens distortion and an off-centre principal point, which are left out, move it so much.
_LEAST_SIGMA = 0.01

# Tried for a start, in image widths.
_TRIALS = (0.87, 0.6, 1.2, 1.8, 2.6)


def estimate_camera(grey: Grey, boards: Sequence[Board]) -> CameraModel | None:
    """The likeliest distortion-free camera with square pixels and a centred principal point; None without a board.

    Args:
        grey: the photo (height, width).

    Returns:
        Its `focal_sigma` is what the photo leaves open, as a share of the focal length.
    """
    height, width = grey.shape
    longer = max(width, height)
    photo = grey.astype(np.float32)
    best: dict[str, _Estimate] = {}
    for share in _TRIALS:
        camera = CameraModel.pinhole(width, height, share * longer)
        for seen in locate(grey, camera, boards)[0]:
            if seen.status is not Status.OK:
                continue
            found = _refined(photo, camera, seen, _USUAL * longer)
            if found and (seen.board.name not in best or found.misfit < best[seen.board.name].misfit):
                best[seen.board.name] = found
    return combined_camera(width, height, [(found.log_focal, found.sigma) for found in best.values()])


def combined_camera(width: int, height: int, estimates: Sequence[tuple[float, float]]) -> CameraModel | None:
    """The camera that several estimates of ln(focal), each with its standard deviation, speak for; None without any."""
    if not estimates:
        return None
    values, sigmas = np.array(estimates).T
    weights = sigmas**-2.0
    mean = float((weights * values).sum() / weights.sum())
    return CameraModel.pinhole(width, height, math.exp(mean), max(float(weights.sum() ** -0.5), _LEAST_SIGMA))


@dataclass(frozen=True)
class _Estimate:
    log_focal: float
    sigma: float
    misfit: float


def _refined(photo: NDArray[np.float32], camera: CameraModel, seen: Sighting, usual: float) -> _Estimate | None:
    assert seen.T_board_in_cam is not None
    markers = tuple(seen.board.ids.index(number) for number in seen.markers)
    pieces = [Piece(seen.board, np.eye(4), markers)]
    T, blur, fit = seen.T_board_in_cam, seen.blur or 0.9, None
    # Focal length and tilt lie in a long valley: the second walk starts where the first one along it ended.
    for _ in range(2):
        prior = Guess(math.log(usual / camera.focal), _USUAL_SPREAD / INFLATION)
        fit = align(photo, camera, pieces, T, blur, prior)
        if fit is None:
            return None
        T, blur = fit.T_ref_in_cam, fit.blur
        camera = CameraModel.pinhole(camera.width, camera.height, camera.focal * math.exp(fit.zoom))
    assert fit is not None
    sigma = min(max(fit.zoom_sigma * INFLATION, _LEAST_SIGMA), _USUAL_SPREAD)
    return _Estimate(math.log(camera.focal), sigma, fit.cost / fit.pixels)
