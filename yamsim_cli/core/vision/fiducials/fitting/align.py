"""Refine a pose by the boards' whole picture rather than by a few corners.

The boards' print is known to the last cell. So it is drawn as the camera would see it from a supposed pose, blurred as
the lens blurs it, and the pose (and the blur) is moved until drawing and photo agree best: least squares over all
pixels, brightness and contrast free for each marker, outlying pixels weighted down. Corners found one by one lie on
blurred black-to-white edges and are pushed about by their neighbours; here neighbours and blur are part of the model.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ....geometry.camera import CameraModel
from ....geometry.se3 import Array, pose, rotation_from_vector
from .descent import PrintProblem, System, weighed
from .linearize import Pixels, Tile, linearized
from .print_shape import CREASED_SHARE, marginalized, mode_count, placement_modes, shape_modes
from .print_view import Piece, PrintView, plane_of, view_print
from .smear import Smear

Grey = NDArray[np.float32]

# Blur (sigma, pixels of a `PrintView`) that is believed: less cannot be told from none, more is no picture of a marker.
BLUR_RANGE = (0.25, 5.0)
# The longest motion that is believed, px of a `PrintView`.
_MOST_MOTION = 20.0

# Where nothing is known of it yet.
USUAL_SMEAR = Smear(0.9)

# The photo's noise is not all there is: standard deviations once the print's shape and placement are marginalized, over
# what noise alone explains. At 1.3, 95 % intervals hold at least 95 % of the poses in each of six sets of 40 to 120
# (`python -m tests.bench.print_shape`, seeds below 200, and `tests.bench.filament`); 1.4 leaves a margin.
INFLATION = 1.4

# How far (px) growing by one moves the print once the distance has made up for most of it.
_GROWTH_PX = 4.0


@dataclass(frozen=True)
class Alignment:
    """How a print and its picture agree.

    Attributes:
        T_ref_in_cam: pose (4, 4).
        covariance: (6, 6) of a small rotation (rad, about the camera's axes) about `centre` and of the shift of
            `centre` (m, along them), from the photo's noise and, of `with_shape`, from what the print's shape leaves
            open.
        by_lens: (6, k) how the pose moves, in the same measure, with what `CameraModel.mistakes` are about.
        by_print: (6,) how it moves with the natural logarithm of the print's size; 0 for what was found too, since the
            covariance then holds it.
        centre: the point (3,) of the reference frame that these are about: the middle of the pieces.
        smear: blur and motion, px.
        noise: standard deviation of the residuals, grey levels.
        cost: weighted sum of squared residuals over `pixels` pixels.
        pixels: how many were compared.
        tiles: for each piece, marker -> how drawing and photo agree there.
        growth: natural logarithm of how much larger the print is than its board says; 0 where it was not asked for.
        flat: probability that the print is flat, as on a rigid plate; 1 where it was not asked for.
    """

    T_ref_in_cam: Array
    covariance: Array
    by_lens: Array
    by_print: Array
    centre: Array
    smear: Smear
    noise: float
    cost: float
    pixels: int
    tiles: tuple[dict[int, Tile], ...]
    growth: float = 0.0
    flat: float = 1.0


@dataclass(frozen=True)
class Guess:
    """What is known beforehand of the natural logarithm of a scale that is to be found too, and where to start."""

    mean: float
    sigma: float
    start: float = 0.0


def align(
    photo: Grey,
    camera: CameraModel,
    pieces: Sequence[Piece],
    T_ref_in_cam: Array,
    smear: Smear = USUAL_SMEAR,
    growth: Guess | None = None,
    roughly: bool = False,
) -> Alignment | None:
    """Move a pose until the boards' print agrees best with the photo.

    Args:
        photo: grey levels (height, width).
        pieces: what to compare.
        T_ref_in_cam: where to start, right to about a marker's cell.
        smear: where to start; motion is found too where there is some.
        growth: find the print's size too; without, the boards' is taken as it is.
        roughly: stop sooner: how well the print agrees is told as well by then, where it is less so.

    Returns:
        None where nothing of the pieces lies in the picture, or the fit breaks down.
    """
    views = _views(photo, camera, pieces, T_ref_in_cam)
    if views is None:
        return None
    fit = _PoseProblem(views, camera, _centre(pieces), moving=smear.length > 0, growth=growth, roughly=roughly)
    found = fit.solve(_State(T_ref_in_cam, smear, growth.start if growth else 0.0))
    return None if found is None else fit.alignment(*found)


def agreement(
    photo: Grey, camera: CameraModel, pieces: Sequence[Piece], T_ref_in_cam: Array, smear: Smear, noise: float
) -> Alignment | None:
    """How well the print agrees with the photo at a given pose, which is not moved; residuals weighted for `noise`."""
    views = _views(photo, camera, pieces, T_ref_in_cam)
    if views is None:
        return None
    fit, state = _PoseProblem(views, camera, _centre(pieces), moving=False), _State(T_ref_in_cam, smear)
    system = fit.system(state, noise)
    return None if system is None else fit.alignment(state, system)


def with_shape(
    photo: Grey,
    camera: CameraModel,
    pieces: Sequence[Piece],
    found: Alignment,
    growth: Guess | None = None,
    creased: float = CREASED_SHARE,
) -> Alignment:
    """Return an alignment with the print's bow, twist and crease marginalized: its pose and a wider covariance.

    Args:
        photo: grey levels (height, width).
        pieces: what `found` compared.
        growth: as `found` was given it.
        creased: prior probability of a creased print.
    """
    views = _views(photo, camera, pieces, found.T_ref_in_cam)
    if views is None:
        return found
    fit = _PoseProblem(views, camera, _centre(pieces), moving=found.smear.length > 0, growth=growth)
    return fit.shaped(_State(found.T_ref_in_cam, found.smear, found.growth), found, creased)


def _views(photo: Grey, camera: CameraModel, pieces: Sequence[Piece], T: Array) -> list[PrintView] | None:
    views = [view for piece in pieces if (view := view_print(photo, camera, piece, plane_of(piece, T))) is not None]
    return views if views and len(views) == len(pieces) else None


def _centre(pieces: Sequence[Piece]) -> Array:
    middle: Array = np.mean([piece.T_board_in_ref[:3, 3] for piece in pieces], axis=0)
    return middle


@dataclass(frozen=True)
class _State:
    """What is varied: the pose (4, 4), the smear, and the logarithm of the print's growth."""

    T: Array
    smear: Smear
    growth: float = 0.0


# Places among all parameters: blur, motion, a turn and a shift, the print's growth, and what the lens is doubted for.
_BLUR, _MOTION, _POSE, _GROWTH, _LENS = 0, slice(1, 3), slice(3, 9), 9, slice(10, None)


_Columns = Callable[[Pixels, Piece, Array, float], Array]


class _PoseProblem(PrintProblem[_State]):
    """Least squares over the pose's six parameters, the blur, and motion and the print's size if they are sought."""

    def __init__(
        self,
        views: Sequence[PrintView],
        camera: CameraModel,
        centre: Array,
        moving: bool,
        growth: Guess | None = None,
        roughly: bool = False,
    ) -> None:
        super().__init__(roughly)
        self._views = views
        self._camera = camera
        self._centre = centre
        self._growth = growth
        motion = range(_MOTION.start, _MOTION.stop) if moving else ()
        self._free = (_BLUR, *motion, *range(_POSE.start, _POSE.stop), *((_GROWTH,) if growth else ()))
        coarser = [view.coarser for view in views]
        self._coarsest = max(coarser)
        self._blur_range = (BLUR_RANGE[0] * min(coarser), BLUR_RANGE[1] * max(coarser))

    def system(self, state: _State, noise: float | None) -> System | None:
        return self._system(state, noise, self._columns)

    def _system(self, state: _State, noise: float | None, columns: _Columns) -> System | None:
        larger = math.exp(state.growth)
        system = weighed(
            [
                linearized(
                    view,
                    plane_of(view.piece, state.T, larger),
                    state.smear,
                    lambda pixels, piece=view.piece: columns(pixels, piece, state.T, larger),  # type: ignore[misc]
                )
                for view in self._views
            ],
            noise,
            self._free,
        )
        if system is None or self._growth is None:
            return system
        strength, missing = (system.noise / self._growth.sigma) ** 2, self._growth.mean - state.growth
        normal, gradient = system.every_normal.copy(), system.every_gradient.copy()
        normal[_GROWTH, _GROWTH] += strength
        gradient[_GROWTH] += strength * missing
        misfit = system.misfit + strength * missing**2
        return replace(system, every_normal=normal, every_gradient=gradient, misfit=misfit)

    def _columns(self, pixels: Pixels, piece: Piece, T: Array, larger: float) -> Array:
        """Derivatives (n, 7 + k) of the drawn print: by turn, shift, size, and what the lens is doubted for."""
        R, T_board, at = T[:3, :3], piece.T_board_in_ref, larger * pixels.at
        on_board = at @ (R @ T_board[:3, :2]).T
        from_centre = on_board + R @ (T_board[:3, 3] - self._centre)
        point = from_centre + R @ self._centre + T[:3, 3]
        depth = point[:, 2]
        by_ray = pixels.by_ray
        by_shift = np.column_stack([by_ray, -(by_ray * point[:, :2]).sum(axis=1) / depth]) / depth[:, None]
        along = (by_ray * pixels.rays).sum(axis=1)
        # A longer lens farther away: the part of it that the distance makes up for is left out, and put back in
        # `alignment`, since the rest is small beside it.
        by_focal = along + by_shift[:, 2] * self._depth(T)
        by_lens = [by_focal]
        if self._camera.doubt:
            by_lens += [*(pixels.by_shift * self._camera.focal).T, along * (pixels.rays**2).sum(axis=1)]
        by_size = (by_shift * on_board).sum(axis=1)
        (x, y, z), (a, b, c) = from_centre.T, by_shift.T
        # Their cross product; numpy's own takes several times as long.
        turns = (y * c - z * b, z * a - x * c, x * b - y * a)
        return np.column_stack([*turns, by_shift, by_size, *by_lens])

    def _shape_columns(self, pixels: Pixels, piece: Piece, T: Array, larger: float) -> Array:
        """Derivatives (n, 7 + k + m) by all of `_columns`, then by each piece's shape and placement modes."""
        columns = self._columns(pixels, piece, T, larger)
        # A shift of the print along the axes of its board, at each pixel.
        along_x, along_y, by_height = (columns[:, 3:6] @ T[:3, :3] @ piece.T_board_in_ref[:3, :3]).T[:, :, None]
        by_x, by_y = placement_modes(piece.board, pixels.at)
        own = [by_height * shape_modes(piece.board, pixels.at), along_x * by_x + along_y * by_y]
        others = {view.piece.board: np.zeros((len(columns), mode_count(view.piece.board))) for view in self._views}
        of_pieces = [np.column_stack(own) if view.piece is piece else others[view.piece.board] for view in self._views]
        return np.column_stack([columns, *of_pieces])

    def shaped(self, state: _State, found: Alignment, creased: float) -> Alignment:
        """What was found at a state, with the print's shape marginalized; as it was where that breaks down."""
        system = self._system(state, found.noise, self._shape_columns)
        if system is None:
            return found
        free, boards = list(system.free), [view.piece.board for view in self._views]
        known = len(system.every_gradient) - sum(mode_count(board) for board in boards)
        held = [k for k in range(known) if k not in free]
        # The photo's noise is not all there is, so it counts for more.
        variance = (INFLATION * found.noise) ** 2
        try:
            pose_of = marginalized(system.every_normal, system.every_gradient, variance, free, held, boards, creased)
        except np.linalg.LinAlgError:
            return found
        turns = [free.index(k) for k in range(_POSE.start, _POSE.stop)]
        by_lens = pose_of.moves[turns][:, [n for n, k in enumerate(held) if k >= _LENS.start]]
        by_lens[5, 0] += self._depth(state.T)
        # What a fold moves of the print, it moves by its distance from the crease.
        lever = max(max(view.piece.board.width, view.piece.board.height) for view in self._views) / 2
        neglected = pose_of.neglected * np.diag([1.0] * 3 + [lever**2] * 3)
        growth = held.index(_GROWTH) if _GROWTH in held else None
        return replace(
            found,
            T_ref_in_cam=self.moved(state, pose_of.step).T,
            covariance=pose_of.covariance[np.ix_(turns, turns)] + neglected,
            by_lens=by_lens,
            by_print=found.by_print if growth is None else pose_of.moves[turns, growth],
            flat=pose_of.flat,
        )

    def _depth(self, T: Array) -> float:
        return float((T[:3, :3] @ self._centre + T[:3, 3])[2])

    def moved(self, state: _State, step: Array) -> _State:
        every = self._every(step)
        turn, shift = every[_POSE][:3], every[_POSE][3:]
        R = rotation_from_vector(turn) @ state.T[:3, :3]
        at = state.T[:3, :3] @ self._centre + state.T[:3, 3] + shift
        blur = float(np.clip(state.smear.blur + every[_BLUR], *self._blur_range))
        motion = np.array(state.smear.motion) + every[_MOTION]
        motion *= min(1.0, _MOST_MOTION * self._coarsest / max(float(np.linalg.norm(motion)), 1e-9))
        smear = Smear(blur, (float(motion[0]), float(motion[1])))
        return _State(pose(at - R @ self._centre, R), smear, state.growth + float(every[_GROWTH]))

    def _every(self, step: Array) -> Array:
        """A step of all parameters up to the lens', 0 for what is not varied."""
        every = np.zeros(_LENS.start)
        every[list(self._free)] = step
        return every

    def moved_px(self, state: _State, step: Array) -> float:
        """By the shift, by the turn of something 0.1 m large, and by growing."""
        every = self._every(step)
        turn, shift = every[_POSE][:3], every[_POSE][3:]
        metres = float(np.linalg.norm(shift) + 0.1 * np.linalg.norm(turn))
        return metres * self._camera.focal / max(self._depth(state.T), 1e-3) + _GROWTH_PX * abs(float(every[_GROWTH]))

    def alignment(self, state: _State, system: System) -> Alignment | None:
        """What was found, with its uncertainty; None where the pixels do not determine it."""
        normal, free = system.normal, list(system.free)
        held = [k for k in range(len(system.every_gradient)) if k not in free]
        moves = np.zeros((len(free), len(system.every_gradient)))
        try:
            covariance: Array = np.linalg.inv(normal).astype(np.float64) * system.noise**2
            moves[:, held] = -np.linalg.solve(normal, system.every_normal[np.ix_(free, held)])
        except np.linalg.LinAlgError:
            return None
        if not np.isfinite(covariance).all():
            return None
        turns = [free.index(k) for k in range(_POSE.start, _POSE.stop)]
        by_lens = moves[turns, _LENS]
        by_lens[5, 0] += self._depth(state.T)
        return Alignment(
            state.T,
            covariance[np.ix_(turns, turns)],
            by_lens,
            moves[turns, _GROWTH],
            self._centre,
            state.smear,
            system.noise,
            system.misfit,
            system.pixels,
            system.tiles,
            state.growth,
        )
