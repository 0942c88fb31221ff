"""Refine a pose by the boards' whole image instead of a few corners.

Robust least squares adjusts pose and blur until the rendered print agrees with the photo. Each marker has its own
brightness and contrast. Neighbouring cells and blur displace detected corners; the rendering includes both effects.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array, pose, rotation_from_vector

from .blur_kernel import BlurKernel
from .normal_equations import (
    MarkerTile,
    NormalEquations,
    PixelDerivatives,
    PrintProblem,
    combine_equations,
    linearize_print,
)
from .print_shape import CREASE_PROBABILITY, marginalize_modes, mode_count, placement_modes, shape_modes
from .print_view import PhotoRegion, PrintedBoard, crop_photo_to_print, print_plane

Grey = NDArray[np.float32]

BLUR_RANGE = (0.25, 5.0)  # px of a `PhotoRegion`, sigmas: less blur is invisible, more hides a marker
_MAX_MOTION = 20.0  # px of a `PhotoRegion`
INITIAL_BLUR = BlurKernel(0.9)  # px, at the start of a fit

# Factor on the noise's sigma where the print's shape is marginalized. At 1.3, the 95 % intervals hold at least 95 % of
# the poses in six sets of 40 to 120; 1.4 is safer. Source: `python -m tools.bench.print_shape` with seeds below 200,
# and `tools.bench.filament`.
SIGMA_INFLATION = 1.4

_PX_PER_LOG_SCALE = 4.0  # px, print shift per unit of log scale, beyond what the distance compensates


@dataclass(frozen=True)
class Alignment:
    """A pose fitted to boards, and the agreement of rendered print and photo.

    Attributes:
        T_ref_in_cam: pose (4, 4) of the frame `ref` of the boards' known poses.
        covariance: (6, 6) of a rotation about `centre` (rad) and its shift (m) along the camera's axes, from noise;
            `marginalize_shape` adds the print's shape.
        derivatives_by_lens: (6, k) pose derivatives by the lens parameters of `CameraModel.intrinsics_cholesky`.
        derivatives_by_print_scale: (6,) by the print's log scale; 0 if `covariance` includes a fitted scale.
        centre: mean (3,) of the boards' centres in `ref`, m.
        blur: px of the photo.
        noise: standard deviation of the residuals, grey levels.
        cost: weighted sum of squared residuals over `pixels` pixels.
        tiles: marker -> tile, for each board.
        log_scale: log of print over nominal size; 0 if not fitted.
        flat_probability: that the print is flat, as on a rigid plate; 1 if not estimated.
    """

    T_ref_in_cam: Array
    covariance: Array
    derivatives_by_lens: Array
    derivatives_by_print_scale: Array
    centre: Array
    blur: BlurKernel
    noise: float
    cost: float
    pixels: int
    tiles: tuple[dict[int, MarkerTile], ...]
    log_scale: float = 0.0
    flat_probability: float = 1.0


@dataclass(frozen=True)
class LogScalePrior:
    """A Gaussian prior of the log of print over nominal size, and the fit's start value."""

    mean: float
    sigma: float
    start: float = 0.0


def align_pose(
    photo: Grey,
    camera: CameraModel,
    pieces: Sequence[PrintedBoard],
    T_ref_in_cam: Array,
    blur: BlurKernel = INITIAL_BLUR,
    log_scale_prior: LogScalePrior | None = None,
    coarse: bool = False,
) -> Alignment | None:
    """Fit a pose to a photo (height, width); None if a board is out of the picture, or the fit fails.

    Args:
        T_ref_in_cam: start pose (4, 4), off by at most about one marker cell.
        blur: start value; motion is fitted only if this value has some.
        log_scale_prior: to fit the print's size too; None for the nominal size.
        coarse: stop early, when the cost is known but the pose is less exact.
    """
    fit = _make_pose_problem(photo, camera, pieces, T_ref_in_cam, blur.motion_length > 0, log_scale_prior, coarse)
    if fit is None:
        return None
    found = fit.solve(_PoseState(T_ref_in_cam, blur, log_scale_prior.start if log_scale_prior else 0.0))
    return None if found is None else fit.alignment_at(*found)


def measure_agreement(
    photo: Grey,
    camera: CameraModel,
    pieces: Sequence[PrintedBoard],
    T_ref_in_cam: Array,
    blur: BlurKernel,
    noise: float,
) -> Alignment | None:
    """Compare print and photo at a fixed pose (4, 4). `noise` (sigma, grey levels) weights residuals."""
    fit, state = _make_pose_problem(photo, camera, pieces, T_ref_in_cam, moving=False), _PoseState(T_ref_in_cam, blur)
    if fit is None:
        return None
    system = fit.equations_at(state, noise)
    return None if system is None else fit.alignment_at(state, system)


def marginalize_shape(
    photo: Grey,
    camera: CameraModel,
    pieces: Sequence[PrintedBoard],
    found: Alignment,
    log_scale_prior: LogScalePrior | None = None,
    creased: float = CREASE_PROBABILITY,
) -> Alignment:
    """Marginalize the print's bow, twist and crease: returns a new pose and a wider covariance.

    Args:
        pieces, log_scale_prior: the arguments that gave `found`.
        creased: prior probability of a creased print.
    """
    fit = _make_pose_problem(photo, camera, pieces, found.T_ref_in_cam, found.blur.motion_length > 0, log_scale_prior)
    if fit is None:
        return found
    return fit.with_marginalized_shape(_PoseState(found.T_ref_in_cam, found.blur, found.log_scale), found, creased)


def _make_pose_problem(
    photo: Grey,
    camera: CameraModel,
    pieces: Sequence[PrintedBoard],
    T: Array,
    moving: bool,
    log_scale_prior: LogScalePrior | None = None,
    roughly: bool = False,
) -> _PoseProblem | None:
    views = [
        view
        for piece in pieces
        if (view := crop_photo_to_print(photo, camera, piece, print_plane(piece, T))) is not None
    ]
    if not views or len(views) < len(pieces):
        return None
    centre: Array = np.mean([piece.T_board_in_ref[:3, 3] for piece in pieces], axis=0)
    return _PoseProblem(views, camera, centre, moving, log_scale_prior, roughly)


@dataclass(frozen=True)
class _PoseState:
    T: Array
    blur: BlurKernel
    log_scale: float = 0.0


# Parameter indices; the pose is rotation, then shift.
_BLUR, _MOTION, _POSE, _LOG_SCALE, _LENS = 0, slice(1, 3), slice(3, 9), 9, slice(10, None)


_JacobianFunction = Callable[[PixelDerivatives, PrintedBoard, Array, float], Array]


class _PoseProblem(PrintProblem[_PoseState]):
    def __init__(
        self,
        views: Sequence[PhotoRegion],
        camera: CameraModel,
        centre: Array,
        moving: bool,
        log_scale_prior: LogScalePrior | None,
        roughly: bool,
    ) -> None:
        super().__init__(roughly)
        self._views = views
        self._camera = camera
        self._centre = centre
        self._log_scale = log_scale_prior
        motion = range(_MOTION.start, _MOTION.stop) if moving else ()
        self._free = (_BLUR, *motion, *range(_POSE.start, _POSE.stop), *((_LOG_SCALE,) if log_scale_prior else ()))
        coarser = [view.reduction_factor for view in views]
        self._coarsest = max(coarser)
        self._blur_range = (BLUR_RANGE[0] * min(coarser), BLUR_RANGE[1] * max(coarser))

    def equations_at(self, state: _PoseState, noise: float | None) -> NormalEquations | None:
        return self._equations_by_columns(state, noise, self._pose_columns)

    def _equations_by_columns(
        self, state: _PoseState, noise: float | None, columns: _JacobianFunction
    ) -> NormalEquations | None:
        larger = math.exp(state.log_scale)
        system = combine_equations(
            [
                linearize_print(
                    view,
                    print_plane(view.piece, state.T, larger),
                    state.blur,
                    lambda pixels, piece=view.piece: columns(pixels, piece, state.T, larger),  # type: ignore[misc]
                )
                for view in self._views
            ],
            noise,
            self._free,
        )
        if system is None or self._log_scale is None:
            return system
        strength, missing = (system.noise / self._log_scale.sigma) ** 2, self._log_scale.mean - state.log_scale
        normal, right_hand_side = system.full_normal.copy(), system.full_right_hand_side.copy()
        normal[_LOG_SCALE, _LOG_SCALE] += strength
        right_hand_side[_LOG_SCALE] += strength * missing
        misfit = system.misfit + strength * missing**2
        return replace(system, full_normal=normal, full_right_hand_side=right_hand_side, misfit=misfit)

    def _pose_columns(self, pixels: PixelDerivatives, piece: PrintedBoard, T: Array, larger: float) -> Array:
        """Return print derivatives (n, 7 + k) by rotation, shift, log scale, and k lens parameters."""
        R, T_board, at = T[:3, :3], piece.T_board_in_ref, larger * pixels.board_points
        on_board = at @ (R @ T_board[:3, :2]).T
        from_centre = on_board + R @ (T_board[:3, 3] - self._centre)
        point = from_centre + R @ self._centre + T[:3, 3]
        depth = point[:, 2]
        by_ray = pixels.brightness_by_ray
        by_shift = np.column_stack([by_ray, -(by_ray * point[:, :2]).sum(axis=1) / depth]) / depth[:, None]
        along = (by_ray * pixels.rays).sum(axis=1)
        # A longer focal length mostly changes the distance; `alignment_at` adds that part.
        by_focal = along + by_shift[:, 2] * self._centre_depth(T)
        derivatives_by_lens = [by_focal]
        if self._camera.intrinsics_covariance:
            derivatives_by_lens += [
                *(pixels.brightness_by_shift * self._camera.mean_focal_length).T,
                along * (pixels.rays**2).sum(axis=1),
            ]
        by_size = (by_shift * on_board).sum(axis=1)
        (x, y, z), (a, b, c) = from_centre.T, by_shift.T
        # Several times faster than numpy's cross product.
        turns = (y * c - z * b, z * a - x * c, x * b - y * a)
        return np.column_stack([*turns, by_shift, by_size, *derivatives_by_lens])

    def _shape_columns(self, pixels: PixelDerivatives, piece: PrintedBoard, T: Array, larger: float) -> Array:
        columns = self._pose_columns(pixels, piece, T, larger)
        along_x, along_y, by_height = (columns[:, 3:6] @ T[:3, :3] @ piece.T_board_in_ref[:3, :3]).T[:, :, None]
        by_x, by_y = placement_modes(piece.board, pixels.board_points)
        own = [by_height * shape_modes(piece.board, pixels.board_points), along_x * by_x + along_y * by_y]
        others = {view.piece.board: np.zeros((len(columns), mode_count(view.piece.board))) for view in self._views}
        of_pieces = [np.column_stack(own) if view.piece is piece else others[view.piece.board] for view in self._views]
        return np.column_stack([columns, *of_pieces])

    def with_marginalized_shape(self, state: _PoseState, found: Alignment, creased: float) -> Alignment:
        system = self._equations_by_columns(state, found.noise, self._shape_columns)
        if system is None:
            return found
        free, boards = list(system.free_parameters), [view.piece.board for view in self._views]
        known = len(system.full_right_hand_side) - sum(mode_count(board) for board in boards)
        held = [k for k in range(known) if k not in free]
        variance = (SIGMA_INFLATION * found.noise) ** 2
        try:
            pose_of = marginalize_modes(
                system.full_normal, system.full_right_hand_side, variance, free, held, boards, creased
            )
        except np.linalg.LinAlgError:
            return found
        turns = [free.index(k) for k in range(_POSE.start, _POSE.stop)]
        derivatives_by_lens = pose_of.by_fixed_parameters[turns][:, [n for n, k in enumerate(held) if k >= _LENS.start]]
        derivatives_by_lens[5, 0] += self._centre_depth(state.T)
        # The angle error of a fold moves the print in proportion to the distance from the crease, here the farthest.
        lever = max(max(view.piece.board.width, view.piece.board.height) for view in self._views) / 2
        neglected = pose_of.neglected_variance * np.diag([1.0] * 3 + [lever**2] * 3)
        scale_index = held.index(_LOG_SCALE) if _LOG_SCALE in held else None
        return replace(
            found,
            T_ref_in_cam=self.apply_step(state, pose_of.step).T,
            covariance=pose_of.covariance[np.ix_(turns, turns)] + neglected,
            derivatives_by_lens=derivatives_by_lens,
            derivatives_by_print_scale=found.derivatives_by_print_scale
            if scale_index is None
            else pose_of.by_fixed_parameters[turns, scale_index],
            flat_probability=pose_of.flat_probability,
        )

    def _centre_depth(self, T: Array) -> float:
        return float((T[:3, :3] @ self._centre + T[:3, 3])[2])

    def apply_step(self, state: _PoseState, step: Array) -> _PoseState:
        every = self._full_step(step)
        turn, shift = every[_POSE][:3], every[_POSE][3:]
        R = rotation_from_vector(turn) @ state.T[:3, :3]
        at = state.T[:3, :3] @ self._centre + state.T[:3, 3] + shift
        blur = float(np.clip(state.blur.blur + every[_BLUR], *self._blur_range))
        motion = np.array(state.blur.motion) + every[_MOTION]
        motion *= min(1.0, _MAX_MOTION * self._coarsest / max(float(np.linalg.norm(motion)), 1e-9))
        kernel = BlurKernel(blur, (float(motion[0]), float(motion[1])))
        return _PoseState(pose(at - R @ self._centre, R), kernel, state.log_scale + float(every[_LOG_SCALE]))

    def _full_step(self, step: Array) -> Array:
        every = np.zeros(_LENS.start)
        every[list(self._free)] = step
        return every

    def print_shift_px(self, state: _PoseState, step: Array) -> float:
        # A rotation counts as a shift at 0.1 m.
        every = self._full_step(step)
        turn, shift = every[_POSE][:3], every[_POSE][3:]
        metres = float(np.linalg.norm(shift) + 0.1 * np.linalg.norm(turn))
        return metres * self._camera.mean_focal_length / max(
            self._centre_depth(state.T), 1e-3
        ) + _PX_PER_LOG_SCALE * abs(float(every[_LOG_SCALE]))

    def alignment_at(self, state: _PoseState, system: NormalEquations) -> Alignment | None:
        normal, free = system.normal_matrix, list(system.free_parameters)
        held = [k for k in range(len(system.full_right_hand_side)) if k not in free]
        moves = np.zeros((len(free), len(system.full_right_hand_side)))
        try:
            covariance: Array = np.linalg.inv(normal).astype(np.float64) * system.noise**2
            moves[:, held] = -np.linalg.solve(normal, system.full_normal[np.ix_(free, held)])
        except np.linalg.LinAlgError:
            return None
        if not np.isfinite(covariance).all():
            return None
        turns = [free.index(k) for k in range(_POSE.start, _POSE.stop)]
        derivatives_by_lens = moves[turns, _LENS]
        derivatives_by_lens[5, 0] += self._centre_depth(state.T)
        return Alignment(
            state.T,
            covariance[np.ix_(turns, turns)],
            derivatives_by_lens,
            moves[turns, _LOG_SCALE],
            self._centre,
            state.blur,
            system.noise,
            system.misfit,
            system.pixels,
            system.tiles,
            state.log_scale,
        )
