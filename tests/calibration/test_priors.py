"""What the fit assumes before it sees the pictures."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from yamsim_cli.calibration.calibrate_run import StationCalibrator, _converged_fit, offset_refusal
from yamsim_cli.calibration.camera_start import CameraPrior, CameraStart
from yamsim_cli.calibration.chosen_frames import ChosenFrame
from yamsim_cli.calibration.episode_pictures import EpisodePictures
from yamsim_cli.calibration.station_fit import (
    DELAY,
    FOCAL,
    LENS,
    MOVING,
    FitPriors,
    FittedCameraView,
    Layout,
    StationProblem,
    start_state,
)
from yamsim_cli.calibration.uncertainty import _with_joint2_error, focal_contradiction
from yamsim_cli.camera_effects.lens_distortion import project_points, viewing_ray_grid
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rendering import RenderConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array, pose, rotation_from_vector, rotation_vector, rotation_z
from yamsim_cli.photos.overlay.body_views import BodyRenderer


def test_the_priors_hold_the_rig_and_not_the_start_of_the_fit(station: RigConfig) -> None:
    view = cast(
        Any, SimpleNamespace(renderer=SimpleNamespace(arm_of_body=np.zeros(3, np.int64)), kinds=np.zeros((2, 3)))
    )
    problem = StationProblem(station, [view], [], FitPriors((CameraPrior(0.01),)))
    state = start_state(station, [pose((0.0, 0.0, 1.0))], [0.0], 3)
    assert not problem.prior_deviation(state).any()
    other = 1 - station.recording_order[0]
    bases = list(state.T_arm_in_base)
    bases[other] = pose((0.0, 0.0, 0.02)) @ bases[other] @ pose(rotation=rotation_z(0.01))
    offsets = tuple(np.full_like(one, 0.03) for one in state.offsets)
    removed = StationProblem(station, [view], [], FitPriors((CameraPrior(0.01, 0.05, removed_k1=0.04),)))
    distorted = replace(state, lenses=(0.01,), log_focal=(0.1,))
    assert removed.prior_deviation(state)[problem.layout.camera(0)][LENS] == pytest.approx(0.04)
    deviation = removed.prior_deviation(distorted)[problem.layout.camera(0)][LENS]
    assert deviation == pytest.approx(0.04 * math.exp(0.2) + 0.01)
    farther = removed.prior_deviation(replace(distorted, log_focal=(0.1 + 1e-6,)))[problem.layout.camera(0)][LENS]
    slope = removed._prior_jacobian(distorted)[problem.layout.camera(0).start + LENS, FOCAL]
    assert slope == pytest.approx((farther - deviation) / 1e-6, rel=1e-4)
    moved = problem.prior_deviation(replace(state, delays=(0.05,), offsets=offsets, T_arm_in_base=tuple(bases)))
    assert moved[problem.layout.camera(0)][DELAY] == 0.05
    np.testing.assert_allclose(moved[problem.layout.offsets(other)], 0.03)
    place = problem.layout.base(other)
    np.testing.assert_allclose(moved[place], [0, 0, 0.01, 0, 0, 0.02], atol=1e-9)


def test_an_offset_of_the_first_joint_turns_the_base_body_and_no_link(locations: Locations) -> None:
    rig = load_config(RigConfig, "rigs", "single", locations)
    scene = load_config(SceneConfig, "scenes", "studio", locations)
    quality = load_config(RenderConfig, "quality", "fast", locations)
    joints = np.array([[0.3, 0.5, 0.4, 0.1, 0.2, 0.0]] * 2)
    episode = EpisodePictures("", np.array([0.0, 1.0]), (joints,), (np.zeros(2),), {})
    T_base_in_cam = pose((0.0, 0.1, 1.0), rotation_from_vector([2.0, 0.3, 0.2]))
    with BodyRenderer(rig, scene, quality, CameraModel.from_focal_length(64, 48, 60.0), locations) as renderer:
        state = start_state(rig, [T_base_in_cam], [0.0], len(renderer.arm_of_body))

        def poses(offset: float) -> list[Array]:
            own = replace(state, offsets=(np.array([offset, 0, 0, 0, 0, 0]),))
            renderer.set_poses(own.base_poses(0), own.postures(episode, 0.5, 0))
            return list(renderer.body_poses())

        before, after = poses(0.0), poses(0.02)
        links = renderer.moved_by[0][0]
        base = (renderer.arm_of_body == 0) & ~links
    np.testing.assert_allclose(np.array(after)[links], np.array(before)[links], atol=1e-6)
    for old, new in zip(np.array(before)[base], np.array(after)[base], strict=True):
        np.testing.assert_allclose(rotation_vector(new[:3, :3] @ old[:3, :3].T), 0.02 * T_base_in_cam[:3, 2], atol=1e-6)


def test_an_error_of_the_second_joint_widens_what_follows_it() -> None:
    layout = Layout(1, 0, (6,), 0)
    fit = cast(Any, SimpleNamespace(layout=layout))
    joint, tilt = layout.offsets(0).start + 1, layout.camera(0).start
    covariance = np.diag(np.full(layout.size, 1e-6))
    covariance[joint, tilt] = covariance[tilt, joint] = 0.5e-6
    wider = _with_joint2_error(covariance, fit, 0.004)
    assert wider[joint, joint] == pytest.approx(1e-6 + 0.004**2)
    assert wider[tilt, tilt] == pytest.approx(1e-6 + 0.002**2)
    assert wider[joint + 1, joint + 1] == pytest.approx(1e-6)


def test_implausible_joint_offsets_are_refused(station: RigConfig) -> None:
    state = start_state(station, [pose((0.0, 0.0, 1.0))], [0.0], 3)
    assert offset_refusal(station, state) is None
    state.offsets[0][4] = np.radians(-4.0)
    refusal = offset_refusal(station, state)
    assert refusal is not None and f"joint 5 of {station.arms[0].name} would have an offset of -4.0" in refusal


def test_a_focal_length_moved_beyond_its_interval_widens_all_intervals() -> None:
    layout = Layout(2, 0, (6,), 0)
    sigma = np.full(layout.size, np.inf)
    sigma[[layout.camera(number).start + FOCAL for number in (0, 1)]] = 0.003, 0.4
    moved = {}
    for name, log_focal in (("little", (0.005, 0.3)), ("far", (-0.0118, 0.3))):
        fit = cast(Any, SimpleNamespace(layout=layout, state=SimpleNamespace(log_focal=log_focal)))
        moved[name] = focal_contradiction(sigma, fit)
    assert moved == {"little": 1.0, "far": pytest.approx(2.0, rel=0.01)}


def test_a_distortion_belongs_to_its_focal_length() -> None:
    # The same lens: k1 at the true focal length of 390 px, and at the guess of 300 px.
    true = CameraModel.from_focal_length(640, 480, 390.0)
    start = CameraStart(CameraModel.from_focal_length(640, 480, 300.0), False, False)
    log_focal = math.log(1.3)
    guessed = start.with_removed_k1(0.08, log_focal)
    pixels = [[20.0, 30.0], [320.0, 10.0], [600.0, 400.0]]
    focal = [
        project_points(replace(model, distortion=(k1, 0.0, 0.0, 0.0)), np.column_stack([rays, np.ones(3)]))
        for model, k1 in ((true, 0.08), (guessed.model, guessed.k1))
        for rays in [(np.array(pixels) - [319.5, 239.5]) / model.K[0][0]]
    ]
    np.testing.assert_allclose(focal[0], focal[1], atol=1e-9)
    assert guessed.fitted_model(0.0, log_focal).distortion[0] == pytest.approx(0.08)
    fitted = guessed.fitted_model(0.01, log_focal)
    assert (fitted.distortion[0], fitted.K[0][0]) == (pytest.approx(0.09), pytest.approx(390.0))
    assert guessed.with_removed_k1(0.01, log_focal).k1 == pytest.approx(guessed.k1 + 0.01 / 1.3**2)


def test_a_removed_distortion_reaches_the_corners_of_the_picture() -> None:
    for focal in (300.0, 390.0, 800.0):
        start = CameraStart(CameraModel.from_focal_length(640, 480, focal), True, False)
        removed = start.with_removed_k1(-9.0, 0.0)
        assert -0.2 <= removed.k1 < 0
        corner = viewing_ray_grid(removed.model, np.array([-0.5, 639.5]), np.array([-0.5, 479.5])).reshape(-1, 2)
        seen = project_points(removed.model, np.column_stack([corner, np.ones(4)]))
        np.testing.assert_allclose(seen, [[-0.5, -0.5], [639.5, -0.5], [-0.5, 479.5], [639.5, 479.5]], atol=1e-3)
        assert start.with_removed_k1(9.0, 0.0).k1 == 0.2


def test_a_given_distortion_follows_the_fitted_focal_length() -> None:
    rational = (-0.3, 0.1, 0.002, -0.001, 0.02, 0.1, 0.05, 0.01, 0.003, -0.002, 0.001, 0.004)
    model = replace(CameraModel.from_focal_length(640, 480, 600.0), distortion=rational)
    fitted = CameraStart(model, True, True).fitted_model(0.0, math.log(1.05))
    assert fitted.K[0][0] == pytest.approx(630.0)
    rays = np.array([[0.3, 0.2, 1.0], [-0.4, 0.3, 1.0], [0.1, -0.35, 1.0]])
    # The pictures were undistorted with the given lens, and the fit sees them with 1.05 times its focal length.
    np.testing.assert_allclose(project_points(fitted, rays), project_points(model, rays * [1.05, 1.05, 1.0]), atol=1e-9)


def test_the_fit_finds_a_distortion_that_remains_in_the_pictures(locations: Locations) -> None:
    rig = load_config(RigConfig, "rigs", "single", locations)
    scene = load_config(SceneConfig, "scenes", "studio", locations)
    quality = load_config(RenderConfig, "quality", "fast", locations)
    camera = CameraModel.from_focal_length(320, 240, 200.0)
    rng = np.random.default_rng(0)
    joints = np.array([0.0, 1.0, 1.0, 0.0, 0.0, 0.0]) + rng.uniform(-0.7, 0.7, (8, 6))
    times = np.arange(8.0)
    episode = EpisodePictures("", times, (joints,), (np.zeros(8),), {})
    T_base_in_cam = pose((-0.1, 0.15, 0.6), rotation_from_vector([1.9, 0.2, 0.3]))
    lens = replace(camera, distortion=(0.08, 0.0, 0.0, 0.0))
    rays = viewing_ray_grid(lens, np.arange(320), np.arange(240))
    with BodyRenderer(rig, scene, quality, camera, locations) as renderer:
        K = renderer.intrinsics.K
        state = start_state(rig, [T_base_in_cam], [0.0], len(renderer.arm_of_body))
        frames = []
        for k in range(8):
            renderer.set_poses(state.base_poses(0), state.postures(episode, times[k], 0))
            picture = renderer.body_picture()
            soft = cv2.GaussianBlur((picture.bodies > 0).astype(np.uint8) * 250, (0, 0), 0.8)
            across, down = (rays @ K[:2, :2].T + K[:2, 2]).astype(np.float32).transpose(2, 0, 1)
            photo = np.asarray(cv2.remap(soft, across, down, cv2.INTER_LINEAR), dtype=np.uint8)
            seen = renderer.undistort_photo(photo)
            mask = seen > 125
            image = np.repeat(seen[..., None], 3, axis=2)
            frames.append(ChosenFrame(0, k, float(times[k]), image, seen, 0, np.ones_like(mask), seen, mask))
        kinds = np.where(renderer.arm_of_body >= 0, MOVING, 0).astype(np.uint8)
        view = FittedCameraView("top", renderer, tuple(frames), np.tile(kinds, (8, 1)))
        priors = FitPriors((CameraPrior(0.003, 0.05),), delay=0.0, offset=0.0)
        found = StationProblem(rig, [view], [episode], priors).fit(state).state
        held = StationProblem(rig, [view], [episode], replace(priors, cameras=(CameraPrior(0.003),))).fit(state).state
    assert found.lenses[0] == pytest.approx(0.08, abs=0.015)
    assert abs(held.lenses[0]) < 1e-6
    errors = [np.linalg.norm(one.T_base_in_cam[0][:3, 3] - T_base_in_cam[:3, 3]) for one in (found, held)]
    assert errors[0] < 0.5 * errors[1]


def test_a_refusal_names_near_if_what_moves_reaches_the_border() -> None:
    def hint(near: object, *masks: NDArray[np.bool_]) -> str:
        calibrator = cast(Any, SimpleNamespace(_request=SimpleNamespace(near=near)))
        return StationCalibrator._border_hint(calibrator, cast(Any, [SimpleNamespace(changed=one) for one in masks]))

    inside, cut = np.zeros((2, 60, 80), dtype=bool)
    inside[20:40, 30:50] = True
    cut[20:40, 50:] = True
    assert "--near" in hint(None, cut, cut, cut, inside)
    assert not hint(None, cut, inside)
    assert not hint("calibration.yaml", cut)


@pytest.mark.parametrize(("shares", "used"), [((0.2, 0.4, 0.7, 0.9), 2), ((0.2, 0.22, 0.9), 0), ((0.65, 0.9), 0)])
def test_a_fit_that_finds_few_edges_goes_on_as_long_as_it_finds_more(shares: tuple[float, ...], used: int) -> None:
    def fit(number: int) -> Any:
        equations = (SimpleNamespace(camera=0, found=100 * shares[number], points=100),)
        return SimpleNamespace(state=number, equations=equations)

    problem = cast(Any, SimpleNamespace(fit=lambda state: fit(state + 1)))
    found: Any = _converged_fit(problem, fit(0))
    assert found.state == used
