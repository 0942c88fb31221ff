"""Intervals of a station's fit: from its equations, widened by the scatter between groups of pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..core.geometry.se3 import Array, invert_pose, rotation_vector
from ..core.statistics import Z95, student_t_quantile_95
from .station_fit import (
    DELAY,
    FOCAL,
    LENS,
    SHARED_ERRORS,
    FitPriors,
    FittedCameraView,
    StationFit,
    StationProblem,
    StationState,
)

_MIN_GROUPS = 8  # groups of pictures; with fewer episodes, each is divided
# px, an angle of joint 2 times the focal length: standard deviation of what errors of all edges do to its offset,
# which looks like a tilt of the base. Of six planted stations, three had offsets that were wrong by 0.2 to 0.5 degrees.
_JOINT2_ERROR = 1.3
_EXPOSURE = 0.005  # s; a picture shows some time, and its stamp is from its beginning, middle or end
_HALF_REACHES = (3.5, 2.5, 2.5, 2.5)  # grains, rounds of the fit of a half
# Share of the interval before the fit. A value counts as measured if its interval is narrower than this.
_MAX_INTERVAL_RATIO = 0.7

Groups = NDArray[np.int64]  # (frames,) numbers of groups


def is_measured(half_width: float, prior: float) -> bool:
    """Return whether the half width of a 95 % interval is clearly less than the half width of the prior."""
    return half_width < _MAX_INTERVAL_RATIO * Z95 * prior


def is_base_measured(position_95_mm: Sequence[float], rotation_95_deg: Sequence[float]) -> bool:
    """Return whether all half widths (3,) of the second base's 95 % intervals, mm and degrees, are measured."""
    priors = FitPriors()
    return is_pose_measured(position_95_mm, rotation_95_deg, priors.base_shift, priors.base_turn)


def is_pose_measured(
    position_95_mm: Sequence[float], rotation_95_deg: Sequence[float], shift: float, turn: float
) -> bool:
    """Return whether all half widths (3,) of a pose are measured, with prior standard deviations in m and rad."""
    return is_measured(max(position_95_mm) / 1000, shift) and is_measured(math.radians(max(rotation_95_deg)), turn)


@dataclass(frozen=True)
class PoseInterval:
    """Half widths of 95 % intervals along the axes of the reference base: `position` (3,), m, and `turn` (3,), rad."""

    position: Array
    turn: Array


@dataclass(frozen=True)
class StationIntervals:
    """Half widths of 95 % intervals, and differences between two halves of the pictures.

    Attributes:
        cameras: of each camera's pose in the reference base.
        log_focal, lenses, delays: of each camera; s for the delays.
        offsets: of each arm's joint offsets (dof,), rad.
        bases: of each arm's base in the reference base; zero for the reference.
        halves_position, halves_turn: differences (m, rad) between each camera's poses from either half; no intervals.
    """

    cameras: tuple[PoseInterval, ...]
    log_focal: tuple[float, ...]
    lenses: tuple[float, ...]
    delays: tuple[float, ...]
    offsets: tuple[Array, ...]
    bases: tuple[PoseInterval, ...]
    halves_position: tuple[float, ...]
    halves_turn: tuple[float, ...]


def picture_groups(views: Sequence[FittedCameraView]) -> list[Groups]:
    """Return the group of each picture, by camera: its episode or, with few episodes, a part of one."""
    episodes = sorted({frame.episode for view in views for frame in view.frames})
    parts = -(-_MIN_GROUPS // len(episodes))
    groups = []
    for view in views:
        own = np.array([frame.episode for frame in view.frames])
        numbers = np.zeros(len(own), np.int64)
        for number, episode in enumerate(episodes):
            places = np.flatnonzero(own == episode)
            numbers[places] = number * parts + np.arange(len(places)) * parts // max(len(places), 1)
        groups.append(numbers)
    return groups


def estimate_intervals(problem: StationProblem, fit: StationFit) -> StationIntervals:
    """Return the intervals of a fit."""
    groups = picture_groups(problem.views)
    focal = float(np.mean([view.renderer.intrinsics.fx for view in problem.views]))
    covariance = _with_joint2_error(_covariance(fit, groups), fit, _JOINT2_ERROR / focal)
    covariance = focal_contradiction(problem.sigma, fit) ** 2 * covariance
    halves = [_fit_half(problem, fit.state, groups, parity) for parity in (0, 1)]
    cameras, apart = [], []
    for number in range(fit.layout.cameras):
        own, difference = _camera_interval(fit, covariance, number), _camera_difference(halves, number)
        cameras.append(_widened(own, difference))
        apart.append(difference)
    widths = Z95 * np.sqrt(np.diag(covariance))
    layout = fit.layout
    one, other = halves

    def of_cameras(
        place: int, first: Sequence[float], second: Sequence[float], least: float = 0.0
    ) -> tuple[float, ...]:
        """Return a half width for each camera: of the parameter at `place`, whose values differ between the halves."""
        own = [float(widths[layout.camera(number).start + place]) for number in range(layout.cameras)]
        return tuple(max(w, abs(a - b) / 2, least) for w, a, b in zip(own, first, second, strict=True))

    bases = []
    for arm in range(len(layout.dofs)):
        place = layout.base(arm)
        bases.append(
            PoseInterval(np.zeros(3), np.zeros(3))
            if place is None
            else _widened(
                PoseInterval(widths[place][3:], widths[place][:3]),
                _pose_difference(one.T_arm_in_base[arm], other.T_arm_in_base[arm]),
            )
        )
    return StationIntervals(
        tuple(cameras),
        of_cameras(FOCAL, one.log_focal, other.log_focal),
        of_cameras(LENS, one.lenses, other.lenses),
        of_cameras(DELAY, one.delays, other.delays, least=_EXPOSURE),
        tuple(
            np.maximum(widths[layout.offsets(arm)], np.abs(one.offsets[arm] - other.offsets[arm]) / 2)
            for arm in range(len(layout.dofs))
        ),
        tuple(bases),
        tuple(float(np.linalg.norm(d.position)) for d in apart),
        tuple(float(np.linalg.norm(d.turn)) for d in apart),
    )


def _covariance(fit: StationFit, groups: Sequence[Groups]) -> Array:
    """Return the covariance (k, k): of the fit's equations, and of their scatter between groups of pictures."""
    information = fit.prior + sum(one.normal for one in fit.equations)
    inverse = np.linalg.inv(information)
    by_group: dict[int, Array] = {}
    for one in fit.equations:
        group = int(groups[one.camera][one.frame])
        by_group[group] = by_group.get(group, np.zeros(len(information))) + one.right_hand_side
    count = len(by_group)
    scatter = np.zeros_like(information)
    if count > 1:
        right_hand_sides = np.array(list(by_group.values()))
        right_hand_sides -= right_hand_sides.mean(axis=0)
        scatter = right_hand_sides.T @ right_hand_sides * count / (count - 1)
        scatter *= (student_t_quantile_95(count - 1) / Z95) ** 2
    both: Array = inverse @ (information + SHARED_ERRORS**2 * scatter) @ inverse
    return both


def _with_joint2_error(covariance: Array, fit: StationFit, sigma: float) -> Array:
    """Return a covariance (k, k) with an error of each arm's second joint, which the other parameters follow."""
    for arm in range(len(fit.layout.dofs)):
        joint = fit.layout.offsets(arm).start + 1
        # By how much the others change with it, as the pictures relate them.
        following = covariance[:, joint] / covariance[joint, joint]
        covariance = covariance + sigma**2 * np.outer(following, following)
    return covariance


def focal_contradiction(sigma: Array, fit: StationFit) -> float:
    """Return how far the fit moved a focal length, in half widths of its 95 % interval before the fit; 1 at least.

    A farther move shows that the outlines are wrong by more than their equations say. `sigma` (k,) are the priors'
    standard deviations.
    """
    moves = [
        focal_move(log_focal, float(sigma[fit.layout.camera(number).start + FOCAL]))
        for number, log_focal in enumerate(fit.state.log_focal)
    ]
    return max(1.0, *moves)


def focal_move(log_focal: float, sigma: float) -> float:
    """Return how far a focal length moved, in half widths of its 95 % interval; `sigma` is that of its logarithm."""
    return abs(log_focal) / (Z95 * sigma)


def _camera_interval(fit: StationFit, covariance: Array, number: int) -> PoseInterval:
    start = fit.layout.camera(number).start
    T, centre = fit.state.T_base_in_cam[number], fit.centres[number]
    # A step moves the base about `centre` in the camera's axes; seen from the base, the camera moves the other way.
    cross = np.array([[0, -centre[2], centre[1]], [centre[2], 0, -centre[0]], [-centre[1], centre[0], 0]])
    R = T[:3, :3].T
    by_step = np.block([[-R, np.zeros((3, 3))], [-R @ cross, -R]])
    own = by_step @ covariance[start : start + 6, start : start + 6] @ by_step.T
    widths = Z95 * np.sqrt(np.diag(own))
    return PoseInterval(widths[3:], widths[:3])


def _widened(interval: PoseInterval, difference: PoseInterval) -> PoseInterval:
    """Return an interval that is wider if the halves differ by more than it predicts."""
    # The difference of two halves has twice the standard deviation of all pictures' fit.
    position, turn = (
        max(1.0, float(np.sqrt(np.mean((d / (2 * np.maximum(w, 1e-12) / Z95)) ** 2))))
        for d, w in ((difference.position, interval.position), (difference.turn, interval.turn))
    )
    return PoseInterval(interval.position * position, interval.turn * turn)


def _fit_half(problem: StationProblem, state: StationState, groups: Sequence[Groups], parity: int) -> StationState:
    views = []
    for view, own in zip(problem.views, groups, strict=True):
        chosen = np.flatnonzero(own % 2 == parity)
        frames = tuple(view.frames[k] for k in chosen)
        views.append(replace(view, frames=frames, kinds=view.kinds[chosen]))
    return problem.with_views(views).fit(state, _HALF_REACHES).state


def _camera_difference(halves: Sequence[StationState], number: int) -> PoseInterval:
    one, other = (invert_pose(half.T_base_in_cam[number]) for half in halves)
    return _pose_difference(one, other)


def _pose_difference(one: Array, other: Array) -> PoseInterval:
    return PoseInterval(one[:3, 3] - other[:3, 3], rotation_vector(one[:3, :3] @ other[:3, :3].T))
