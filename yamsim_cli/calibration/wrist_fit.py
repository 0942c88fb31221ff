"""Estimate where a wrist camera is on the flange, from the outline of the gripper that it always sees.

Behind the gripper, the pictures change as the arm moves. So the mean of pictures with the same opening shows the edges
of the gripper alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.config.rendering import RenderConfig
from ..core.config.rig import RigConfig
from ..core.config.scene import SceneConfig
from ..core.errors import DatasetError
from ..core.files.resources import Locations
from ..core.geometry.camera import CameraModel
from ..core.geometry.se3 import Array, invert_pose, rotation_vector
from ..core.images.image import Image
from ..core.scene.cameras import wrist_camera_pose
from ..core.statistics import Z95
from ..photos.edge_alignment import (
    PoseCorrection,
    edge_offsets,
    edge_spread,
    edge_weights,
    grain_px,
    mask_outline,
    points_in_camera,
)
from ..photos.overlay.body_views import BodyRenderer
from .camera_start import CameraStart, fitted_k1
from .chosen_frames import spread_choice, weighted_poses
from .episode_pictures import EpisodePictures
from .station_fit import EDGE_SIGMA, lens_jacobian, rendered_edges
from .uncertainty import PoseInterval, focal_move, is_pose_measured

_BIN = 0.002  # m of one finger's opening; pictures within count as of the same opening
_BINS = 5  # openings, at most
_MIN_PICTURES = 12  # of an opening; with fewer, the mean shows what lies behind the gripper
_PICTURES = 30  # of an opening, at most
_STARTS = 40  # poses near the rig's from which the fit starts; from one alone, it ends at wrong edges
_START_TURN, _START_SHIFT = math.radians(2.5), 0.006  # rad and m, standard deviations of their distances from the rig's
_START_REACHES = (10.0, 6.0, 3.5)  # grains, search distance for edges by round, from each start
_BEST = 4  # starts whose fit continues
_REACHES = (3.5, 2.5, 2.5, 2.5, 2.5, 2.5)  # grains, the same for these
_FAR = 3.0  # grains, reach of the last equations, and the distance that counts for a point without an edge
_PRIOR_TURN, _PRIOR_SHIFT = math.radians(5.0), 0.02  # rad and m, standard deviations of the rig's pose
_BIASES = (0.5, 0.3, 0.3)  # px, standard deviations of shifts that all edges share: outwards, to the right and down
_INFLATION = 3.5  # of intervals; without it, the errors of a planted camera exceeded them by up to 3.4 times
_MIN_FOUND = 0.6  # share of outline points with an edge within `_FAR`; fewer mean a wrong gripper or pose
_MIN_SIGMA = 1e-6  # of the logarithm of the focal length and of k1; less makes the equations singular
# Share of outline points with an edge at a single opening, from which nothing hides the outline. In two planted
# handovers, openings without an object had 0.92 to 0.97, others 0.50 to 0.87.
_CLEAR_FOUND = 0.9
_FOCAL, _LENS, _SIZE = 6, 7, 11  # places among the parameters, after turn and shift, and their number


@dataclass(frozen=True)
class WristFit:
    """The pose (4, 4) of a wrist camera's OpenCV frame on the flange.

    Attributes:
        arm: number of the arm.
        model: the camera with the fitted focal length and distortion, to which the pose belongs.
        k1_95: half width of the 95 % interval of its distortion k1; None for a given distortion.
        interval: half widths of the 95 % intervals along and about the flange's axes.
        pictures, openings: pictures that were used, and the number of their means, each of an opening in an episode.
        found_share: share of the outline's points with an edge.
        outline_px: median distance of the outline to the edges, px.
    """

    name: str
    arm: int
    T_cam_in_flange: Array
    model: CameraModel
    k1_95: float | None
    interval: PoseInterval
    pictures: int
    openings: int
    found_share: float
    outline_px: float


@dataclass(frozen=True)
class _MeanPicture:
    """The mean of `count` pictures of an episode, grey (height, width), and the time of one of them, s."""

    grey: NDArray[np.uint8]
    episode: EpisodePictures
    time: float
    count: int


@dataclass(frozen=True)
class WristOutcome:
    """Result of the pictures of a wrist camera: a fit, and why it is refused, or None for a certain pose."""

    name: str
    fit: WristFit | None
    refusal: str | None


def is_wrist_camera_measured(position_95_mm: Sequence[float], rotation_95_deg: Sequence[float]) -> bool:
    """Return whether all half widths (3,) of a wrist camera's 95 % intervals, mm and degrees, are measured."""
    return is_pose_measured(position_95_mm, rotation_95_deg, _PRIOR_SHIFT, _PRIOR_TURN)


def estimate_wrist_camera(
    name: str,
    start: CameraStart,
    rig: RigConfig,
    episodes: Sequence[EpisodePictures],
    surroundings: tuple[SceneConfig, RenderConfig, Locations],
    limits: tuple[float, float],
) -> WristOutcome:
    """Return the pose of a wrist camera of the rig.

    Args:
        start: its intrinsics.
        limits: m and rad. A pose whose interval has larger half widths is refused.
    """
    arm = [one.wrist_camera_name for one in rig.arms].index(name)
    scene, quality, locations = surroundings
    try:
        means = _mean_pictures(name, arm, episodes, start.model)
        with BodyRenderer(rig, scene, quality, start.model, locations) as renderer:
            problem = _WristProblem(arm, rig, renderer, means, start)
            found = _search(problem)
            if start.is_lens_known:
                found = _without_hidden(problem, found)
        if not start.is_lens_known:
            # The fit is linear in k1. So the estimate is removed from the pictures, and what remains is fitted.
            start = start.with_removed_k1(float(found.state[_LENS]), float(found.state[_FOCAL]))
            found = replace(found, state=np.where(np.arange(_SIZE) == _LENS, 0.0, found.state))
            with BodyRenderer(rig, scene, quality, start.model, locations) as renderer:
                problem = _WristProblem(arm, rig, renderer, found.means, start)
                found = _without_hidden(problem, problem.continued(found))
    except DatasetError as error:
        return WristOutcome(name, None, str(error))
    if found.rows.found_share < _MIN_FOUND:
        no_edges = (
            f"the gripper's outline meets the edges of pictures at {found.rows.found_share:.0%} of its points, at "
            f"least {_MIN_FOUND:.0%} are needed: are the gripper and the wrist camera those of the rig, and is the "
            "camera's calibration correct?"
        )
        return WristOutcome(name, None, no_edges)
    fit = _wrist_fit(name, arm, start, found)
    shift, turn = float(fit.interval.position.max()), float(fit.interval.turn.max())
    refusal = None
    if shift > limits[0] or turn > limits[1]:
        refusal = (
            f"its pose is uncertain by {1000 * shift:.1f} mm and {math.degrees(turn):.2f} degrees (95 %), more than "
            f"{1000 * limits[0]:g} mm and {math.degrees(limits[1]):g} degrees (--max-shift, --max-turn): give larger "
            "pictures, or more episodes with different openings of the gripper"
        )
    return WristOutcome(name, fit, refusal)


@dataclass(frozen=True)
class _Rows:
    """The equations of a step (_SIZE, _SIZE) and (_SIZE,), and how well the outline meets the edges.

    Attributes:
        found_share: share of outline points with an edge within `_FAR`.
        median: distance of the outline from the edges, px.
        cost: mean distance, px, in which points without an edge count with `_FAR`.
    """

    normal: Array
    right_hand_side: Array
    found_share: float
    median: float
    cost: float


@dataclass(frozen=True)
class _Solution:
    """The values of a fit.

    Attributes:
        T_flange_in_cam: pose (4, 4) of the flange in the camera.
        state: parameters (_SIZE,) from `_FOCAL` on; the first six are not used.
        means: the pictures that were fitted.
    """

    T_flange_in_cam: Array
    state: Array
    rows: _Rows
    means: Sequence[_MeanPicture]


def _search(problem: _WristProblem) -> _Solution:
    """Return the best fit near the rig's pose: to all mean pictures or, if it finds few edges, to a clear one."""
    found = problem.search()
    if found.rows.found_share < _MIN_FOUND and len(problem.means) > 1:
        # An object between the fingers hides the outline at the openings at which they hold it. So take one opening.
        alone = [problem.with_means([one]).search() for one in problem.means]
        best = max(alone, key=lambda one: one.rows.found_share)
        if best.rows.found_share >= _CLEAR_FOUND:
            return best
    return found


def _without_hidden(problem: _WristProblem, found: _Solution) -> _Solution:
    """Return the fit without the pictures in which something hides the outline, unless it is hidden in all."""

    def share(one: _MeanPicture) -> float:
        return problem.with_means([one]).linearize(found.T_flange_in_cam, found.state, _FAR).found_share

    clear = [one for one in found.means if share(one) >= _CLEAR_FOUND]
    if not clear or len(clear) == len(found.means):
        return found
    return problem.with_means(clear).continued(found)


def _wrist_fit(name: str, arm: int, start: CameraStart, found: _Solution) -> WristFit:
    """Return a fit with its intervals.

    They are wider if the fit moved the focal length beyond its interval, which shows that outlines are wrong by more
    than the equations say.
    """
    log_focal, remaining = float(found.state[_FOCAL]), float(found.state[_LENS])
    inflation = _INFLATION * max(1.0, focal_move(log_focal, max(start.prior.focal, _MIN_SIGMA)))
    covariance = inflation**2 * np.linalg.inv(found.rows.normal)
    T_cam_in_flange = invert_pose(found.T_flange_in_cam)
    # A step (turn w, shift s) of the flange in the camera's axes turns the camera, whose pose on the flange is (R, p),
    # by -R w and shifts it by p x R w - R s in the flange's axes.
    R, (x, y, z) = T_cam_in_flange[:3, :3], T_cam_in_flange[:3, 3]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    by_step = np.block([[-R, np.zeros((3, 3))], [cross @ R, -R]])
    widths = Z95 * np.sqrt(np.diag(by_step @ covariance[:6, :6] @ by_step.T))
    return WristFit(
        name=name,
        arm=arm,
        T_cam_in_flange=T_cam_in_flange,
        model=start.fitted_model(remaining, log_focal),
        k1_95=None if start.is_lens_known else Z95 * math.sqrt(covariance[_LENS, _LENS]),
        interval=PoseInterval(widths[3:], widths[:3]),
        pictures=sum(one.count for one in found.means),
        openings=len(found.means),
        found_share=found.rows.found_share,
        outline_px=found.rows.median,
    )


def _mean_pictures(name: str, arm: int, episodes: Sequence[EpisodePictures], model: CameraModel) -> list[_MeanPicture]:
    """Return the mean pictures of the commonest openings, each of different poses of one episode.

    Raises:
        DatasetError: too few pictures, or pictures of another size than the camera's.
    """
    found = []
    for episode in episodes:
        if name not in episode.cameras:
            continue
        times = episode.cameras[name].times
        bins = np.round(np.interp(times, episode.times, episode.openings[arm]) / _BIN).astype(int)
        for value in np.unique(bins):
            places = np.flatnonzero(bins == value)
            if len(places) >= _MIN_PICTURES:
                found.append((len(places), episode, places))
    found.sort(key=lambda one: -one[0])
    means = []
    for _, episode, places in found[:_BINS]:
        times = episode.cameras[name].times[places]
        chosen = [int(places[k]) for k in spread_choice(weighted_poses(episode, times), _PICTURES)]
        images = episode.read_pictures(name, chosen, model)
        middle = float(episode.cameras[name].times[chosen[len(chosen) // 2]])
        means.append(_MeanPicture(_mean_grey(images), episode, middle, len(chosen)))
    if not means:
        raise DatasetError(f"no opening of the gripper is in {_MIN_PICTURES} pictures or more; give more episodes")
    return means


def _mean_grey(images: Sequence[Image]) -> NDArray[np.uint8]:
    mean = np.mean([cv2.cvtColor(one, cv2.COLOR_RGB2GRAY) for one in images], axis=0)
    return np.asarray(np.round(mean), dtype=np.uint8)


class _WristProblem:
    """Equations of turn and shift, the logarithm of the focal length, the remaining k1, and the three shared biases."""

    def __init__(
        self, arm: int, rig: RigConfig, renderer: BodyRenderer, means: Sequence[_MeanPicture], start: CameraStart
    ) -> None:
        self._arm, self._rig, self._renderer, self.means, self._start = arm, rig, renderer, means, start
        gripper = renderer.moved_by[arm][-1]
        self._gripper = gripper & (renderer.arm_of_body == arm)
        self._undistorted = [renderer.undistort_photo(one.grey) for one in means]
        known = start.prior
        lens = max(known.focal, _MIN_SIGMA), max(known.lens, _MIN_SIGMA)
        sigma = np.array([_PRIOR_TURN] * 3 + [_PRIOR_SHIFT] * 3 + [*lens, *_BIASES])
        self._prior, self._removed_k1 = np.diag(sigma**-2.0), known.removed_k1
        self._T_prior = invert_pose(wrist_camera_pose(rig.arms[arm]))

    def with_means(self, means: Sequence[_MeanPicture]) -> _WristProblem:
        """Return the same problem with other pictures."""
        return _WristProblem(self._arm, self._rig, self._renderer, means, self._start)

    def search(self) -> _Solution:
        """Return the best fit from many poses at and near the rig's."""
        rng = np.random.default_rng(0)
        fits = []
        for number in range(_STARTS):
            step = np.concatenate([rng.normal(0, _START_TURN, 3), rng.normal(0, _START_SHIFT, 3)]) * (number > 0)
            fits.append(self._refine(self.moved(self._T_prior, step), np.zeros(_SIZE), _START_REACHES))
        fits.sort(key=lambda one: one.rows.cost)
        finished = [self._refine(one.T_flange_in_cam, one.state, _REACHES) for one in fits[:_BEST]]
        return min(finished, key=lambda one: one.rows.cost)

    def continued(self, found: _Solution) -> _Solution:
        """Return the fit that starts at another's result."""
        return self._refine(found.T_flange_in_cam, found.state, _REACHES)

    def _refine(self, T: Array, state: Array, reaches: Sequence[float]) -> _Solution:
        for reach in reaches:
            rows = self.linearize(T, state, reach)
            step: Array = np.linalg.solve(rows.normal, rows.right_hand_side).astype(np.float64)
            T, state = self.moved(T, step), state + step
        return _Solution(T, state, self.linearize(T, state, _FAR), self.means)

    def moved(self, T: Array, step: Array) -> Array:
        """Return the flange's pose after a step that turns about the flange."""
        return PoseCorrection(step[:6], T[:3, 3]).apply_to_pose(T)

    def _deviation(self, T: Array, state: Array) -> Array:
        turn = rotation_vector(T[:3, :3] @ self._T_prior[:3, :3].T)
        k1 = fitted_k1(self._removed_k1, float(state[_LENS]), float(state[_FOCAL]))
        return np.concatenate([turn, T[:3, 3] - self._T_prior[:3, 3], [state[_FOCAL], k1], state[_LENS + 1 :]])

    def linearize(self, T_flange_in_cam: Array, state: Array, reach: float) -> _Rows:
        """Return the equations of a step, weighted robustly, and how many outline points have an edge."""
        parts = [
            self._mean_rows(one, grey, T_flange_in_cam, state, reach)
            for one, grey in zip(self.means, self._undistorted, strict=True)
        ]
        residuals = np.concatenate([own for _, own, _ in parts])
        points = sum(count for _, _, count in parts)
        grain = grain_px(self._undistorted[0].shape)
        sigma = edge_spread(residuals, EDGE_SIGMA * grain)
        normal = self._prior.copy()
        right_hand_side = -self._prior @ self._deviation(T_flange_in_cam, state)
        for J, own, _ in parts:
            weighted = J * edge_weights(own, sigma, sigma)[:, None]
            normal += weighted.T @ J
            right_hand_side += weighted.T @ own
        median = float(np.median(np.abs(residuals))) if len(residuals) else math.inf
        found = len(residuals) / max(points, 1)
        near = float(np.minimum(np.abs(residuals), _FAR * grain).mean()) if len(residuals) else _FAR * grain
        return _Rows(normal, right_hand_side, found, median, found * near + (1 - found) * _FAR * grain)

    def _mean_rows(
        self, one: _MeanPicture, grey: NDArray[np.uint8], T: Array, state: Array, reach: float
    ) -> tuple[Array, Array, int]:
        renderer = self._renderer
        postures = one.episode.postures_at(one.time)
        renderer.set_focal_scale(math.exp(state[_FOCAL]))
        renderer.set_poses({self._arm: np.eye(4)}, postures)
        flange = renderer.flange_pose(self._arm)
        renderer.set_poses({self._arm: T @ invert_pose(flange)}, postures)
        picture = renderer.body_picture()
        line = mask_outline(self._gripper[picture.bodies], renderer.outside_photo)
        seen = edge_offsets(grey, line, reach).offsets
        seen = seen - rendered_edges(picture, self._gripper, line, 0.0).offsets
        inside = np.round(line.points - 1.5 * line.normals).astype(int)
        depth = picture.depth[inside[:, 1], inside[:, 0]].astype(np.float64)
        use = np.isfinite(seen) & (depth > 0)
        K = renderer.intrinsics.K
        K[[0, 1], [0, 1]] *= math.exp(state[_FOCAL])
        normals = line.normals[use]
        points, across = points_in_camera(line.points[use], normals, depth[use], K)
        focal, lens = lens_jacobian(line.points[use], normals, K)
        J = np.column_stack([np.cross(points - T[:3, 3], across), across, focal, lens, np.ones(len(points)), normals])
        # The gripper is rendered without the remaining distortion and the biases.
        return J, seen[use] - J[:, _LENS:] @ state[_LENS:], len(line.points)
