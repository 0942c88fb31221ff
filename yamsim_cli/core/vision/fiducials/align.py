"""Refine a pose by the boards' whole picture rather than by a few corners.

The boards' print is known to the last cell. So it is drawn as the camera would see it from a supposed pose, blurred as
the lens blurs it, and the pose (and the blur) is moved until drawing and photo agree best: least squares over all
pixels, brightness and contrast free for each marker, outlying pixels weighted down. Corners found one by one lie on
blurred black-to-white edges and are pushed about by their neighbours; here neighbours and blur are part of the model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...geometry.camera import CameraModel
from ...geometry.se3 import Array, pose, rotation_from_vector
from .linearize import State, Tile, linearized
from .print_view import Piece, PrintView, view_print

Grey = NDArray[np.float32]

# Blur (sigma, pixels of a `PrintView`) that is believed: less cannot be told from none, more is no picture of a marker.
BLUR_RANGE = (0.25, 4.0)

# Residuals beyond this many standard deviations count less and less (Huber's 95 % efficiency).
_HUBER = 1.345

_MAX_ITERATIONS = 30
# Steps below this no longer matter: shift of the print in the picture, px.
_CONVERGED_PX = 4e-3

# The least noise (grey levels) that is believed: rounding alone makes as much.
_LEAST_NOISE = 0.3
# The longest step of the zoom, and how far (px) a zoom by one moves the print once the distance has made up for most of
# it.
_ZOOM_STEP = 0.2
_ZOOM_PX = 4.0


@dataclass(frozen=True)
class Alignment:
    """How a print and its picture agree.

    Attributes:
        T_ref_in_cam: pose (4, 4).
        covariance: (6, 6) of a small rotation (rad, about the camera's axes) about `centre` and of the shift of
            `centre` (m, along them), from the photo's noise alone.
        by_focal, by_print: (6,) how the pose moves, in the same measure, with the natural logarithm of the focal length
            and of the print's size; 0 for what was found too, since the covariance then holds it.
        centre: the point (3,) of the reference frame that these are about: the middle of the pieces.
        blur: sigma, px.
        noise: standard deviation of the residuals, grey levels.
        cost: weighted sum of squared residuals over `pixels` pixels.
        pixels: how many were compared.
        tiles: for each piece, marker -> how drawing and photo agree there.
        zoom, zoom_sigma: natural logarithm of how much longer the focal length is than the camera says, and its
            standard deviation from the noise alone; both 0 where it was not asked for.
        growth: natural logarithm of how much larger the print is than its board says; 0 where it was not asked for.
    """

    T_ref_in_cam: Array
    covariance: Array
    by_focal: Array
    by_print: Array
    centre: Array
    blur: float
    noise: float
    cost: float
    pixels: int
    tiles: tuple[dict[int, Tile], ...]
    zoom: float = 0.0
    zoom_sigma: float = 0.0
    growth: float = 0.0


@dataclass(frozen=True)
class Guess:
    """What is known beforehand of the natural logarithm of a scale that is to be found too, and where to start."""

    mean: float
    sigma: float
    start: float = 0.0


@dataclass(frozen=True)
class _System:
    """Normal equations over all that could be varied, and what the residuals look like.

    Attributes:
        normal, gradient: (9, 9) and (9,): the pose's six parameters, blur, zoom, growth.
    """

    normal: Array
    gradient: Array
    cost: float
    weight: float
    pixels: int
    noise: float
    tiles: tuple[dict[int, Tile], ...]


def align(
    photo: Grey,
    camera: CameraModel,
    pieces: Sequence[Piece],
    T_ref_in_cam: Array,
    blur: float = 0.9,
    zoom: Guess | None = None,
    growth: Guess | None = None,
) -> Alignment | None:
    """Move a pose until the boards' print agrees best with the photo.

    Args:
        photo: grey levels (height, width).
        pieces: what to compare.
        T_ref_in_cam: where to start, right to about a marker's cell.
        blur: where to start, sigma in px.
        zoom: find the focal length too; without, the camera's is taken as it is.
        growth: find the print's size too; without, the boards' is taken as it is.

    Returns:
        None where nothing of the pieces lies in the picture, or the fit breaks down.
    """
    views = _views(photo, camera, pieces, T_ref_in_cam)
    if views is None:
        return None
    fit = _Problem(views, _centre(pieces), zoom, growth)
    state, damping = State(T_ref_in_cam, blur, zoom.start if zoom else 0.0, growth.start if growth else 0.0), 1e-3
    system = fit.system(state, noise=None)
    for _ in range(_MAX_ITERATIONS):
        if system is None:
            return None
        step = fit.step(system, damping)
        moved = _shift_px(camera, state.T, fit.centre, step[:6]) + _ZOOM_PX * float(np.abs(step[7:]).sum())
        there = fit.moved(state, step)
        trial = fit.system(there, noise=system.noise)
        if trial is not None and trial.cost / trial.weight <= system.cost / system.weight:
            state, damping = there, max(damping / 8, 1e-6)
            system = replace(trial, noise=_noise(trial))
        else:
            damping *= 8
        if moved < _CONVERGED_PX or damping > 1e4:
            break
    return None if system is None else fit.alignment(system, state)


def agreement(
    photo: Grey, camera: CameraModel, pieces: Sequence[Piece], T_ref_in_cam: Array, blur: float, noise: float
) -> Alignment | None:
    """How well the print agrees with the photo at a given pose, which is not moved; residuals weighted for `noise`."""
    views = _views(photo, camera, pieces, T_ref_in_cam)
    if views is None:
        return None
    fit, state = _Problem(views, _centre(pieces)), State(T_ref_in_cam, blur)
    system = fit.system(state, noise)
    return None if system is None else fit.alignment(system, state)


def _views(photo: Grey, camera: CameraModel, pieces: Sequence[Piece], T: Array) -> list[PrintView] | None:
    views = [view for piece in pieces if (view := view_print(photo, camera, piece, T)) is not None]
    return views if views and len(views) == len(pieces) else None


def _centre(pieces: Sequence[Piece]) -> Array:
    middle: Array = np.mean([piece.T_board_in_ref[:3, 3] for piece in pieces], axis=0)
    return middle


def _noise(system: _System) -> float:
    return float(np.sqrt(system.cost / max(1.0, system.weight - 7)))


# Places of the scales among all parameters.
_ZOOM, _GROWTH = 7, 8


class _Problem:
    """Least squares over the pose's six parameters, the blur, and the scales that are sought."""

    def __init__(
        self, views: Sequence[PrintView], centre: Array, zoom: Guess | None = None, growth: Guess | None = None
    ) -> None:
        self.centre = centre
        self._views = views
        self._guesses = {k: guess for k, guess in ((_ZOOM, zoom), (_GROWTH, growth)) if guess is not None}
        self._free = [*range(7), *self._guesses]
        coarser = [view.coarser for view in views]
        self._blur_range = (BLUR_RANGE[0] * min(coarser), BLUR_RANGE[1] * max(coarser))

    def system(self, state: State, noise: float | None) -> _System | None:
        """Normal equations at a state; residuals weighted for a given noise, or for the noise found."""
        parts = [linearized(view, state, self.centre) for view in self._views]
        whole = [part for part in parts if part is not None]
        if len(whole) < len(parts):
            return None
        residual = np.concatenate([part[0] for part in whole])
        jacobian = np.concatenate([part[1] for part in whole])
        if noise is None:
            noise = float(1.4826 * np.median(np.abs(residual)))
        noise = max(noise, _LEAST_NOISE)
        weight = np.minimum(1.0, _HUBER * noise / np.maximum(np.abs(residual), 1e-9))
        weighted = jacobian * weight[:, None]
        normal, gradient = weighted.T @ jacobian + 1e-12 * np.eye(9), weighted.T @ residual
        cost = float(weight @ residual**2)
        for k, guess in self._guesses.items():
            strength = (noise / guess.sigma) ** 2
            missing = guess.mean - (state.zoom if k == _ZOOM else state.growth)
            normal[k, k] += strength
            gradient[k] += strength * missing
            cost += strength * missing**2
        tiles = tuple(part[2] for part in whole)
        return _System(normal, gradient, cost, float(weight.sum()), len(residual), noise, tiles)

    def step(self, system: _System, damping: float) -> Array:
        """The step (9,) that Levenberg and Marquardt take; 0 for what is not varied."""
        normal = system.normal[np.ix_(self._free, self._free)]
        step = np.zeros(9)
        step[self._free] = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), system.gradient[self._free])
        return step

    def moved(self, state: State, step: Array) -> State:
        """The state a step away."""
        zoom, growth = np.clip(step[_ZOOM:], -_ZOOM_STEP, _ZOOM_STEP)
        turn = rotation_from_vector(step[:3])
        at = (state.T[:3, :3] @ self.centre + state.T[:3, 3]) * (1, 1, math.exp(zoom))
        R = turn @ state.T[:3, :3]
        blur = float(np.clip(state.blur + step[6], *self._blur_range))
        T = pose(at + step[3:6] - R @ self.centre, R)
        return State(T, blur, state.zoom + float(zoom), state.growth + float(growth))

    def alignment(self, system: _System, state: State) -> Alignment | None:
        """What was found, with its uncertainty; None where the pixels do not determine it."""
        held = [k for k in (_ZOOM, _GROWTH) if k not in self._guesses]
        normal = system.normal[np.ix_(self._free, self._free)]
        by_scale = np.zeros((6, 9))
        try:
            covariance: Array = np.linalg.inv(normal).astype(np.float64) * system.noise**2
            by_scale[:, held] = -np.linalg.solve(normal, system.normal[np.ix_(self._free, held)])[:6]
        except np.linalg.LinAlgError:
            return None
        if not np.isfinite(covariance).all():
            return None
        if _ZOOM in held:
            # Its column leaves out what the distance makes up for.
            by_scale[5, _ZOOM] += (state.T[:3, :3] @ self.centre + state.T[:3, 3])[2]
        zoom_sigma = 0.0 if _ZOOM in held else math.sqrt(max(0.0, covariance[7, 7]))
        return Alignment(
            state.T,
            covariance[:6, :6],
            by_scale[:, _ZOOM],
            by_scale[:, _GROWTH],
            self.centre,
            state.blur,
            system.noise,
            system.cost,
            system.pixels,
            system.tiles,
            state.zoom,
            zoom_sigma,
            state.growth,
        )


def _shift_px(camera: CameraModel, T: Array, centre: Array, step: Array) -> float:
    """About how far a step moves the print in the picture: by the shift, and by the turn of something 0.1 m large."""
    depth = float((T[:3, :3] @ centre + T[:3, 3])[2])
    return float(np.linalg.norm(step[3:6]) + 0.1 * np.linalg.norm(step[:3])) * camera.focal / max(depth, 1e-3)
