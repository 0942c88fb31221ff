"""Calibrate a station: search each camera's pose, fit all cameras together, and refuse what is not certain."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ..core.config.rendering import RenderConfig
from ..core.config.rig import RigConfig
from ..core.config.scene import SceneConfig
from ..core.errors import UsageError
from ..core.files.resources import Locations
from ..core.geometry.camera import CameraModel
from ..core.geometry.se3 import Array, invert_pose
from ..core.progress import Progress
from ..photos.overlay.body_views import BodyRenderer
from .calibration_file import Calibration
from .camera_start import CameraStart
from .camera_views import PreparedCamera, prepare_camera, with_clean_backgrounds
from .chosen_frames import ChosenFrame
from .episode_pictures import EpisodePictures
from .exchanges import WristCameraMoves, exchange_arms, has_two_equal_arms, wrist_camera_fault
from .pose_search import Hypothesis, mask_overlap, search_poses
from .station_fit import FitPriors, FittedCameraView, StationFit, StationProblem, StationState, start_state
from .uncertainty import StationIntervals, estimate_intervals
from .wrist_fit import WristOutcome, estimate_wrist_camera

EXCHANGED_OVERLAP = "exchanged_overlap"  # figure of a camera whose pictures show exchanged arms
_MIN_FRAMES = 16  # pictures; with fewer, the scatter between groups of them is not significant
_MIN_CHANGED = 0.005  # share of a picture that changes with the arms, of the median picture
_MIN_MOTION = math.radians(5)  # rad, smallest range of some joint of the reference arm in the pictures of a camera
_MIN_OVERLAP = 0.25  # intersection over union of the moving bodies with what changes
_BORDER_PX = 12  # px: undistorted pictures show at least 1 % more than the camera, and more with a distorted lens
_BORDER_SHARE = 0.7  # share of pictures in which what moves reaches the border, from which the arms may be cut off
_MAX_CHANCE = 0.85  # the overlap for exchanged poses, as a share of that for each picture's own pose
_MIN_FOUND = 0.6  # share of outline points with an edge within the last reach
_MIN_PROGRESS = 0.05  # share of found edges that a continued fit must gain to be continued again
_EXCHANGE_GAIN = 1.15  # times the overlap as recorded, from which the arms' joints count as exchanged
_RIVAL = 0.04  # a second pose whose share of found edges is less by this or less explains the pictures as well
_MAX_OFFSET = math.radians(3.5)  # rad of a joint, 3.5 standard deviations of the assumed ones; a wrong gripper gave 4.4
_FOCAL_GUESS = 0.9  # of the longer side: first guess of an unknown focal length
_FOCAL_SCALES = (0.7, 0.9, 1.15, 1.5)  # tried factors of that guess
_SHARED_REACHES = (5.0, 3.5, 2.5, 2.5, 2.5, 2.5)  # grains, rounds of the fit of all cameras together


@dataclass(frozen=True)
class CalibrationRequest:
    """What to calibrate.

    Attributes:
        cameras: names of the fixed cameras.
        models: known camera calibrations, by name.
        frames: most pictures of a camera.
        max_shift, max_turn: half widths of 95 % intervals, m and rad, beyond which a pose is refused.
        near: an earlier calibration of the station, whose poses are tried first.
        wrist_cameras: names of the rig's wrist cameras.
    """

    cameras: tuple[str, ...]
    models: Mapping[str, CameraModel]
    frames: int
    max_shift: float
    max_turn: float
    near: Calibration | None = None
    wrist_cameras: tuple[str, ...] = ()

    def with_near(self, near: Calibration | None) -> CalibrationRequest:
        """Return the request with an earlier calibration."""
        return replace(self, near=near)


@dataclass(frozen=True)
class CameraOutcome:
    """Result of the pictures of a camera.

    Attributes:
        start: its intrinsics before the last fit.
        refusal: why its pose is not certain, with a remedy; None for a certain pose.
        figures: frames, overlap and so on, for the report.
    """

    name: str
    start: CameraStart
    refusal: str | None
    figures: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class StationOutcome:
    """The result for a station.

    Attributes:
        cameras: all that were asked for.
        fitted: names of the cameras in `views`, `fit` and `intervals`, in their order.
        fit, intervals: None if no camera has a pose.
    """

    cameras: tuple[CameraOutcome, ...]
    fitted: tuple[str, ...]
    views: tuple[FittedCameraView, ...]
    episodes: tuple[EpisodePictures, ...]
    fit: StationFit | None
    intervals: StationIntervals | None


@dataclass(frozen=True)
class _Started:
    outcome: CameraOutcome
    prepared: PreparedCamera
    state: StationState | None


class StationCalibrator:
    """Calibrates a station. Keep `stack` open as long as the views render."""

    def __init__(
        self,
        rig: RigConfig,
        episodes: Sequence[EpisodePictures],
        request: CalibrationRequest,
        surroundings: tuple[SceneConfig, RenderConfig, Locations],
        stack: ExitStack,
    ) -> None:
        self._rig, self._episodes, self._request = rig, episodes, request
        self._surroundings, self._stack = surroundings, stack

    def run(self, progress: Progress) -> StationOutcome:
        """Return poses and refusals."""
        started = []
        for number, name in enumerate(self._request.cameras):
            progress(number, len(self._request.cameras) + 1)
            started.append(self._with_exchange_told(self._start(name)))
        progress(len(started), len(started) + 1)
        outcome = self._fit_together(started)
        progress(len(started) + 1, len(started) + 1)
        return outcome

    def estimate_wrist_cameras(self, moves: Sequence[WristCameraMoves]) -> list[WristOutcome]:
        """Return the poses of the requested wrist cameras on the flange.

        Both grippers look alike, so a camera of the other arm fits as well as the right one. It is refused by `moves`,
        which says with which arm its pictures change.

        Raises:
            UsageError: a camera has no camera matrix.
        """
        arms = [arm.name for arm in self._rig.arms]
        faults = {one.name: wrist_camera_fault([one], arms) for one in moves}
        limits = self._request.max_shift, self._request.max_turn
        found = []
        for name in self._request.wrist_cameras:
            start = self._camera_start(name)
            if not start.is_focal_known:
                raise UsageError(f"--camera {name}: a wrist camera needs its calibration; give --camera {name}=FILE")
            if fault := faults.get(name):
                found.append(WristOutcome(name, None, fault.removeprefix(f"{name} ")))
                continue
            found.append(estimate_wrist_camera(name, start, self._rig, self._episodes, self._surroundings, limits))
        return found

    def _with_exchange_told(self, started: _Started) -> _Started:
        """Return `started`; if exchanged joints explain the pictures better, its refusal says so."""
        outcome, overlap = started.outcome, started.outcome.figures.get("overlap")
        if outcome.refusal is None or overlap is None or not has_two_equal_arms(self._rig):
            return started
        scene, quality, locations = self._surroundings
        model = self._camera_start(outcome.name).model
        with BodyRenderer(self._rig, scene, quality, model, locations) as renderer:
            episodes = exchange_arms(self._episodes)
            prepared = prepare_camera(outcome.name, episodes, self._rig, renderer, model, self._request.frames)
            scales = (1.0,) if outcome.start.is_focal_known else _FOCAL_SCALES
            known = self._known_poses(outcome.name)
            found = search_poses(prepared.masks, renderer.intrinsics.K, known, scales, 1)
        exchanged = found[0].overlap if found else 0.0
        if exchanged < max(_MIN_OVERLAP, _EXCHANGE_GAIN * overlap):
            return started
        refusal = (
            f"the arms are exchanged: the best pose has an overlap of {exchanged:.2f} with the other arm's joints, and "
            f"of {overlap:.2f} with the recorded ones; import the recording with --swap-arms"
        )
        figures = {**outcome.figures, EXCHANGED_OVERLAP: exchanged}
        return replace(started, outcome=replace(outcome, refusal=refusal, figures=figures))

    def _camera_start(self, name: str) -> CameraStart:
        """Return a camera's given, recorded or guessed intrinsics."""
        if name in self._request.models:
            model = self._request.models[name]
            return CameraStart(model, True, bool(model.distortion))
        pictures = next(one.cameras[name] for one in self._episodes if name in one.cameras)
        height, width = pictures.read([0])[0].shape[:2]
        if pictures.K is not None:
            (a, b, c), (d, e, f), _ = pictures.K.tolist()
            return CameraStart(CameraModel(width, height, ((a, b, c), (d, e, f), (0.0, 0.0, 1.0))), True, False)
        guess = CameraModel.from_focal_length(width, height, _FOCAL_GUESS * max(width, height))
        return CameraStart(guess, False, False)

    def _prepare(self, name: str, model: CameraModel) -> PreparedCamera:
        """Return a camera's pictures without the distortion of `model`."""
        scene, quality, locations = self._surroundings
        renderer = self._stack.enter_context(BodyRenderer(self._rig, scene, quality, model, locations))
        return prepare_camera(name, self._episodes, self._rig, renderer, model, self._request.frames)

    def _start(self, name: str) -> _Started:
        start = self._camera_start(name)
        prepared = self._prepare(name, start.model)
        frames = prepared.view.frames
        changed = float(np.median([frame.changed.mean() for frame in frames]))
        figures = {"frames": len(frames), "changed_share": changed}

        def refused(why: str, **more: float) -> _Started:
            return _Started(CameraOutcome(name, start, why, {**figures, **more}), prepared, None)

        if len(frames) < _MIN_FRAMES:
            return refused(
                f"{len(frames)} pictures show different poses of a slow arm; at least {_MIN_FRAMES} are needed: give "
                "more or longer episodes"
            )
        if self._is_left_arm_still(frames):
            arm = self._rig.arms[self._rig.recording_order[0]].name
            return refused(
                f"no joint of the left arm ({arm}), in whose base poses are given, moves by "
                f"{math.degrees(_MIN_MOTION):.0f} degrees in the chosen pictures: give episodes in which both arms "
                "move; if the pictures show it move, the arms are exchanged: import the recording with --swap-arms"
            )
        if changed < _MIN_CHANGED or not any(len(mask.points) for mask in prepared.masks):
            return refused(
                f"{changed:.1%} of the picture changes when the arms move, at least {_MIN_CHANGED:.1%} are needed: "
                "give episodes in which the camera sees the arms move"
            )
        scales = (1.0,) if start.is_focal_known else _FOCAL_SCALES
        K = prepared.view.renderer.intrinsics.K
        hypotheses = search_poses(prepared.masks, K, self._known_poses(name), scales, 3)
        overlap = hypotheses[0].overlap if hypotheses else 0.0
        if overlap < _MIN_OVERLAP:
            return refused(
                f"no pose explains where the picture changes: the best has an overlap of {overlap:.2f}, at least "
                f"{_MIN_OVERLAP} is needed; are these the pictures of this rig, with radians, and of these episodes?"
                f"{self._border_hint(frames)}",
                overlap=overlap,
            )
        chance = self._chance_overlap(prepared, hypotheses[0])
        figures |= {"overlap": overlap, "chance_overlap": chance}
        if chance > _MAX_CHANCE * overlap:
            return refused(
                f"the arms of other pictures explain a picture as well as its own (overlap {chance:.2f} and "
                f"{overlap:.2f}): are joints and pictures of the same episodes, and do the poses differ?"
            )
        return self._first_fit(name, start, prepared, hypotheses, figures)

    def _is_left_arm_still(self, frames: Sequence[ChosenFrame]) -> bool:
        """Return whether the left of two arms stands still in the chosen pictures.

        Then only edges on an unknown background and the assumed distance of the bases tell where its base is.
        """
        if len(self._rig.arms) == 1:
            return False
        left = self._rig.recording_order[0]
        joints = [self._episodes[one.episode].postures_at(one.time)[left].joints for one in frames]
        return bool(np.ptp(joints, axis=0).max() < _MIN_MOTION)

    def _first_fit(
        self,
        name: str,
        start: CameraStart,
        prepared: PreparedCamera,
        hypotheses: Sequence[Hypothesis],
        figures: Mapping[str, float],
    ) -> _Started:
        """Fit the best hypotheses to the outlines, and keep the best."""
        problem = self._problem([prepared.view], [start])
        fits = []
        for one in hypotheses[:2]:
            focal = math.log(one.focal_scale)
            fits.append(problem.fit(start_state(self._rig, [one.T_base_in_cam], [focal], problem.layout.bodies)))
            if found_share(fits[-1]) > _MIN_FOUND and one.overlap > 1.15 * hypotheses[-1].overlap:
                break
        fits.sort(key=found_share, reverse=True)
        state = fits[0].state
        if not start.is_lens_known:
            # The fit is linear in k1. So the estimate is removed from the pictures, and what remains is fitted.
            start = start.with_removed_k1(state.lenses[0], state.log_focal[0])
            prepared, state = self._prepare(name, start.model), replace(state, lenses=(0.0,))
        prepared = with_clean_backgrounds(prepared, state, 0, self._episodes)
        problem = self._problem([prepared.view], [start])
        best = _converged_fit(problem, problem.fit(state, _SHARED_REACHES))
        share = found_share(best)
        figures = {**figures, "found_share": share, "outline_px": outline_px(best, 0)}
        refusal = None
        if share < _MIN_FOUND:
            refusal = (
                f"the outlines of the arms meet the picture's edges at {share:.0%} of their points, at least "
                f"{_MIN_FOUND:.0%} are needed: are joints and pictures of the same episodes, are the rig's arm and "
                "gripper those in the pictures, and is the camera's calibration correct?"
                f"{self._border_hint(prepared.view.frames)}"
            )
        elif len(fits) > 1 and found_share(fits[1]) > found_share(fits[0]) - _RIVAL and _is_other_pose(*fits):
            refusal = (
                "two different poses explain the pictures about as well: give episodes in which the arm reaches "
                "farther to the sides"
            )
        return _Started(CameraOutcome(name, start, refusal, figures), prepared, best.state)

    def _problem(self, views: Sequence[FittedCameraView], starts: Sequence[CameraStart]) -> StationProblem:
        """Return the fit of cameras' pictures, from which the distortions of `starts` were removed."""
        return StationProblem(self._rig, views, self._episodes, FitPriors(tuple(one.prior for one in starts)))

    def _border_hint(self, frames: Sequence[ChosenFrame]) -> str:
        """Return a remedy if the camera may see only a part of the arms, and no approximate pose was given."""
        if self._request.near or np.mean([_reaches_border(one.changed) for one in frames]) < _BORDER_SHARE:
            return ""
        return (
            " In most pictures, what moves reaches the border: if the camera sees only a part of the arms, give an "
            "earlier calibration of the station (--near)"
        )

    def _known_poses(self, name: str) -> list[Array]:
        """Return the poses of the reference base in the rig's cameras and in the earlier calibration's."""
        reference = self._rig.recording_order[0]
        T_reference = self._rig.T_base_in_world(reference)
        poses = [invert_pose(self._rig.T_cam_in_world(camera)) @ T_reference for camera in self._rig.cameras]
        if self._request.near:
            near = [one for one in self._request.near.cameras if one.name == name] or self._request.near.cameras
            poses += [invert_pose(one.T_cam_in_base) for one in near]
        return poses

    def _chance_overlap(self, prepared: PreparedCamera, best: Hypothesis) -> float:
        """Return the overlap of each picture's mask with the arms of another picture."""
        K = prepared.view.renderer.intrinsics.K
        K[[0, 1], [0, 1]] *= best.focal_scale
        masks = prepared.masks
        half = len(masks) // 2
        others = masks[half:] + masks[:half]
        exchanged = [type(one)(one.changed, other.points) for one, other in zip(masks, others, strict=True)]
        return mask_overlap(exchanged, K, best.T_base_in_cam)

    def _fit_together(self, started: Sequence[_Started]) -> StationOutcome:
        usable = [one for one in started if one.state is not None and one.outcome.refusal is None]
        if not usable:
            return StationOutcome(tuple(one.outcome for one in started), (), (), (), None, None)
        views = tuple(one.prepared.view for one in usable)
        problem = self._problem(views, [one.outcome.start for one in usable])
        fit = problem.fit(_joined_state([one.state for one in usable if one.state]), _SHARED_REACHES)
        intervals = estimate_intervals(problem, fit)
        fitted = tuple(one.outcome.name for one in usable)
        outcomes = []
        for one in started:
            if one.outcome.name not in fitted:
                outcomes.append(one.outcome)
                continue
            outcomes.append(self._judged(one.outcome, fitted.index(one.outcome.name), fit, intervals))
        return StationOutcome(tuple(outcomes), fitted, views, tuple(self._episodes), fit, intervals)

    def _judged(
        self, outcome: CameraOutcome, number: int, fit: StationFit, intervals: StationIntervals
    ) -> CameraOutcome:
        """Return a camera's outcome, refused if its pose is too uncertain."""
        widths = intervals.cameras[number]
        shift, turn = float(widths.position.max()), float(widths.turn.max())
        figures = {
            **outcome.figures,
            "found_share": found_share(fit, number),
            "outline_px": outline_px(fit, number),
            "halves_shift_m": intervals.halves_position[number],
            "halves_turn_rad": intervals.halves_turn[number],
        }
        refusal = offset_refusal(self._rig, fit.state)
        if refusal is None and (shift > self._request.max_shift or turn > self._request.max_turn):
            limits = f"{1000 * self._request.max_shift:g} mm and {math.degrees(self._request.max_turn):g} degrees"
            refusal = (
                f"its pose is uncertain by {1000 * shift:.1f} mm and {math.degrees(turn):.2f} degrees (95 %), more "
                f"than {limits} (--max-shift, --max-turn): {self._remedy(outcome, number, intervals)}"
            )
        return replace(outcome, refusal=refusal, figures=figures)

    def _remedy(self, outcome: CameraOutcome, number: int, intervals: StationIntervals) -> str:
        apart = intervals.halves_position[number]
        if apart > 2 * self._request.max_shift:
            return f"two halves of the pictures differ by {1000 * apart:.1f} mm; was the camera moved between episodes?"
        if outcome.figures["changed_share"] < 0.03:
            return f"the moving arms fill {outcome.figures['changed_share']:.1%} of the picture; give larger pictures"
        if not outcome.start.is_focal_known:
            return "its focal length is estimated too; give its calibration with --camera"
        if not outcome.start.is_lens_known:
            return (
                "its lens distortion is estimated too; give --camera NAME=FILE with `distortion` in the file "
                "([0, 0, 0, 0] for rectified pictures)"
            )
        return "give more episodes with other poses"


def _converged_fit(problem: StationProblem, fit: StationFit) -> StationFit:
    """Return a fit, continued as long as it finds too few edges for a pose and each continuation finds more."""
    while found_share(fit) < _MIN_FOUND:
        again = problem.fit(fit.state)
        if found_share(again) < found_share(fit) + _MIN_PROGRESS:
            break
        fit = again
    return fit


def _reaches_border(mask: NDArray[np.bool_]) -> bool:
    """Return whether a mask (height, width) has pixels near a side."""
    k = _BORDER_PX
    return bool(mask[:k].any() or mask[-k:].any() or mask[:, :k].any() or mask[:, -k:].any())


def found_share(fit: StationFit, camera: int | None = None) -> float:
    """Return the share of outline points with an edge, in all pictures or in a camera's pictures."""
    chosen = [one for one in fit.equations if camera in (None, one.camera)]
    return sum(one.found for one in chosen) / max(sum(one.points for one in chosen), 1)


def offset_refusal(rig: RigConfig, state: StationState) -> str | None:
    """Return why the joint offsets of a fit are not plausible; None if they are."""
    for arm, offsets in zip(rig.arms, state.offsets, strict=True):
        joint = int(np.abs(offsets).argmax())
        if abs(offsets[joint]) > _MAX_OFFSET:
            return (
                f"joint {joint + 1} of {arm.name} would have an offset of {math.degrees(offsets[joint]):.1f} degrees, "
                f"at most {math.degrees(_MAX_OFFSET):g} are plausible: is the rig's arm and gripper the one in the "
                "pictures, and are its joints zeroed?"
            )
    return None


def outline_px(fit: StationFit, camera: int) -> float:
    """Return the median over a camera's pictures of their outlines' median distance to edges, px."""
    values = [one.median for one in fit.equations if one.camera == camera and math.isfinite(one.median)]
    return float(np.median(values)) if values else math.inf


def _is_other_pose(one: StationFit, other: StationFit) -> bool:
    a, b = (invert_pose(fit.state.T_base_in_cam[0]) for fit in (one, other))
    return float(np.linalg.norm(a[:3, 3] - b[:3, 3])) > 0.02


def _joined_state(states: Sequence[StationState]) -> StationState:
    """Return the state of all cameras; joint offsets are means, and bases are from the first."""
    first = states[0]
    return StationState(
        tuple(one.T_base_in_cam[0] for one in states),
        tuple(one.log_focal[0] for one in states),
        tuple(one.delays[0] for one in states),
        tuple(one.margins[0] for one in states),
        tuple(one.lenses[0] for one in states),
        tuple(one.biases[0] for one in states),
        tuple(np.mean([one.offsets[arm] for one in states], axis=0) for arm in range(len(first.offsets))),
        first.T_arm_in_base,
    )
