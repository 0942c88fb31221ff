"""Exchanged arms and wrist cameras."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack

import numpy as np
import pytest

from yamsim_cli.calibration.calibrate_run import CalibrationRequest, StationCalibrator
from yamsim_cli.calibration.episode_pictures import EpisodePictures, TimedPictures
from yamsim_cli.calibration.exchanges import (
    exchange_arms,
    measure_wrist_cameras,
    rank_correlations,
    wrist_camera_fault,
)
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rendering import RenderConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.images.image import Image

TEXTURE = np.random.default_rng(0).integers(0, 255, (60, 400, 3), dtype=np.uint8)


def _turning_view(joints: np.ndarray) -> TimedPictures:
    """A camera that pans over a texture as the first joint turns."""
    times = np.arange(len(joints)) * 0.1

    def read(indices: Sequence[int]) -> list[Image]:
        return [np.roll(TEXTURE, round(200 * float(joints[k, 0])), axis=1)[:, :80] for k in indices]

    return TimedPictures(times, read, None)


def _episode(rig: RigConfig, carrying: tuple[int, int]) -> EpisodePictures:
    """Arms that move by turns; the wrist camera of arm k is carried by arm `carrying[k]`."""
    times = np.arange(80) * 0.1
    first = np.where(times < 4, np.sin(3 * times), np.sin(12.0))
    second = np.where(times < 4, 0.0, np.sin(3 * (times - 4)))
    joints = tuple(np.tile(column[:, None], (1, 6)) * 0.3 for column in (first, second))
    cameras = {arm.wrist_camera_name: _turning_view(joints[carrying[k]]) for k, arm in enumerate(rig.arms)}
    return EpisodePictures("one", times, joints, (np.zeros(80), np.zeros(80)), cameras)


def test_exchanged_wrist_cameras_are_told(station: RigConfig) -> None:
    names = [arm.name for arm in station.arms]
    right = measure_wrist_cameras([_episode(station, (0, 1))], station)
    assert [one.is_on_other_arm for one in right] == [False, False]
    assert wrist_camera_fault(right, names) is None
    wrong = measure_wrist_cameras([_episode(station, (1, 0))], station)
    fault = wrist_camera_fault(wrong, names)
    assert fault is not None and "seem exchanged" in fault
    fault = wrist_camera_fault(wrong, names, are_arms_exchanged=True)
    assert fault is not None and "exchange the names" not in fault and fault.endswith("with --swap-arms")
    one = measure_wrist_cameras([_episode(station, (0, 0))], station)
    fault = wrist_camera_fault(one, names)
    assert fault is not None and f"{station.arms[1].wrist_camera_name} seems to be on {names[0]}" in fault


def test_the_pose_of_a_wrist_camera_on_the_other_arm_is_refused(station: RigConfig, locations: Locations) -> None:
    """Both grippers look alike, so their outlines do not tell."""
    names = tuple(arm.wrist_camera_name for arm in station.arms)
    models = dict.fromkeys(names, CameraModel.from_focal_length(80, 60, 70.0, 0.01))
    episodes = [_episode(station, (1, 0))]
    request = CalibrationRequest((), models, 40, 0.005, 0.01, wrist_cameras=names)
    scene = load_config(SceneConfig, "scenes", "studio", locations)
    surroundings = scene, load_config(RenderConfig, "quality", "fast", locations), locations
    with ExitStack() as stack:
        calibrator = StationCalibrator(station, episodes, request, surroundings, stack)
        found = calibrator.estimate_wrist_cameras(measure_wrist_cameras(episodes, station))
    other = station.arms[1].name
    assert [one.name for one in found] == list(names)
    assert all(one.fit is None for one in found)
    assert found[0].refusal is not None and found[0].refusal.startswith(f"seems to be on {other}: its pictures")


def test_arms_of_an_episode_are_exchanged(station: RigConfig) -> None:
    episode = _episode(station, (0, 1))
    (other,) = exchange_arms([episode])
    np.testing.assert_array_equal(other.joints[0], episode.joints[1])


def test_rank_correlations_share_ranks() -> None:
    found = rank_correlations(np.array([1.0, 2.0, 3.0]), np.array([[3.0, 1.0], [2.0, 1.0], [1.0, 1.0]]))
    assert found == pytest.approx([-1.0, 0.0])
