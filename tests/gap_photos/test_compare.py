"""The simulated arm against photos of the real one: agreement, disagreement, and selection of photos."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.rig_photos import RigPhotographer, looking
from tests.rig_scenes import plant, rig_scene, swings
from tests.truth_photos import CAMERA
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rendering import RenderConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.dataset.dataset_paths import image_path, lowdim_path
from yamsim_cli.core.dataset.lowdim import dump_frame
from yamsim_cli.core.errors import ConfigError, ResourceError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import invert_pose
from yamsim_cli.core.images.jpeg import decode_jpeg
from yamsim_cli.core.recorded_motion import RecordedMotion
from yamsim_cli.gap_photos.photo_comparison import (
    PhotoRequest,
    compare_photos,
    photos_in_parts,
    postures_at,
    select_photos,
)
from yamsim_cli.photos.overlay.photos import PlacedCamera
from yamsim_cli.real.gap.gap_figures import MotionGap, measure_gap

TIMES = np.arange(12) * 0.064
# Photographed samples, and the sample with a simulation error.
TAKEN, OFF = (0, 4, 8, 11), 8
SCENE_CAMERA = "scene_camera"
VIEW = looking((0.9, -0.35, 0.6), (0.05, 0.0, 0.12))


@pytest.fixture(scope="module")
def gap(tmp_path_factory: pytest.TempPathFactory) -> MotionGap:
    """Of an episode's directory without any files."""
    motion = plant(rig_scene(), TIMES, [swings(TIMES, still=0.1)])
    joints = motion.arms[0].joints.copy()
    joints[OFF, 1] += 0.15
    episode = tmp_path_factory.mktemp("dataset") / "ep_000000"
    return measure_gap(rig_scene(), replace(motion, name=str(episode), arms=(replace(motion.arms[0], joints=joints),)))


@pytest.fixture(scope="module")
def photographed(gap: MotionGap, locations: Locations) -> MotionGap:
    """The same with photos of some samples, and frames with the cameras' data."""
    with RigPhotographer("single", locations, CAMERA) as studio:
        for k in TAKEN:
            (stand,) = postures_at(gap.motion, k, studio.rig)
            shot = studio.shoot(VIEW, np.append(stand.joints, stand.opening)[None])
            T_cam_in_base = invert_pose(studio.rig.T_base_in_world(0)) @ VIEW
            frame = {"intrinsics": {SCENE_CAMERA: np.array(CAMERA.K)}, "extrinsics": {SCENE_CAMERA: T_cam_in_base}}
            _write(Path(gap.name), k, shot.image, frame)
    return gap


def _write(episode: Path, k: int, image: np.ndarray, frame: dict[str, object]) -> None:
    for name, data in (
        (image_path(SCENE_CAMERA, k), cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1].tobytes()),
        (lowdim_path(k), dump_frame(frame)),
    ):
        (episode / name).parent.mkdir(parents=True, exist_ok=True)
        (episode / name).write_bytes(data)


def _compare(gap: MotionGap, locations: Locations, request: PhotoRequest):  # type: ignore[no-untyped-def]
    scene = load_config(SceneConfig, "scenes", "studio", locations)
    quality = load_config(RenderConfig, "quality", "fast", locations)
    with RigPhotographer("single", locations, CAMERA) as studio:
        rig = studio.rig
    return compare_photos([gap], rig, request, scene, quality, locations, lambda done, total: None)


@pytest.mark.slow
@pytest.mark.render
def test_the_photo_where_the_arm_was_elsewhere_is_the_worst(photographed: MotionGap, locations: Locations) -> None:
    report, shown = _compare(photographed, locations, PhotoRequest(10))
    assert (report["camera"], report["photos"], report["without_pose"]) == (SCENE_CAMERA, 4, 0)
    assert [frame["frame"] for frame in report["frames"]] == list(TAKEN)
    off, *others = sorted(report["frames"], key=lambda frame: -frame["outline_px"])
    assert off["frame"] == OFF == report["worst"]["frame"]
    assert off["outline_px"] > 3 > 1 > max(frame["outline_px"] for frame in others)
    assert off["iou"] < 0.95 < min(frame["iou"] for frame in others)
    # At the measured joints, every photo fits.
    assert report["measured_outline_px"]["worst"] < 1
    assert "Frame 8 of" in shown[0].caption
    picture = decode_jpeg(shown[0].jpeg)
    assert picture is not None and picture.shape == (480, 640, 3)


@pytest.mark.slow
@pytest.mark.render
def test_a_board_says_where_a_camera_stood_that_nobody_recorded(
    photographed: MotionGap, locations: Locations, tmp_path: Path
) -> None:
    episode = tmp_path / "ep_000001"
    for k in TAKEN[:2]:
        image = cv2.imread(str(Path(photographed.name) / image_path(SCENE_CAMERA, k)))
        _write(episode, k, cv2.cvtColor(image, cv2.COLOR_BGR2RGB), {})
    other = replace(photographed, name=str(episode))
    report, _ = _compare(other, locations, PhotoRequest(10, CAMERA))
    assert report["photos"] == 2 and report["outline_px"]["worst"] < 1
    with pytest.raises(ConfigError, match="320 x 240"):
        _compare(other, locations, PhotoRequest(10, CameraModel.from_focal_length(320, 240, 300.0)))


@pytest.mark.slow
@pytest.mark.render
def test_a_calibration_says_where_the_arm_is_and_by_how_much_its_joints_and_pictures_are_off(
    photographed: MotionGap, locations: Locations
) -> None:
    offsets, delay = np.radians([0.0, 1.5, -1.0, 2.0, 0.0, 0.0]), float(TIMES[1])

    def off(motion: RecordedMotion) -> RecordedMotion:
        """Each photo shows what is measured one sample before its time, and joints have offsets."""
        (arm,) = motion.arms
        return replace(motion, arms=(replace(arm, joints=arm.joints[np.r_[1 : len(TIMES), -1]] + offsets),))

    late = replace(photographed, motion=off(photographed.motion), simulated=off(photographed.simulated))
    # What the frames record of the camera is not used.
    base = load_config(RigConfig, "rigs", "single", locations).T_base_in_world(0)
    placed = PlacedCamera(CAMERA, (invert_pose(VIEW) @ base,), (offsets,), delay)
    worst = {}
    for name, used in {
        "all": placed,
        "no offsets": replace(placed, offsets=(np.zeros(6),)),
        "no delay": replace(placed, delay=0.0),
    }.items():
        report, _ = _compare(late, locations, PhotoRequest(10, placed=used))
        # What was before the first sample is unknown.
        assert report["photos"] == len(TAKEN) - (used.delay > 0)
        worst[name] = report["measured_outline_px"]["worst"]
    assert worst["all"] < 1 < 1.5 < worst["no offsets"]
    assert worst["no delay"] > worst["all"]


@pytest.mark.render
def test_photos_that_do_not_say_where_they_were_taken_from(
    gap: MotionGap, locations: Locations, tmp_path: Path
) -> None:
    episode = tmp_path / "ep_000002"
    _write(episode, 0, np.full((480, 640, 3), 128, np.uint8), {})
    with pytest.raises(ResourceError, match="no photo of camera 'scene_camera' gives its pose"):
        _compare(replace(gap, name=str(episode)), locations, PhotoRequest(10, CAMERA))


def _with_files(gap: MotionGap, episode: Path, camera: str, samples: range) -> MotionGap:
    for k in samples:
        path = episode / image_path(camera, k)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    return replace(gap, name=str(episode))


def test_photos_are_chosen_evenly_and_the_worst_is_among_them(gap: MotionGap, tmp_path: Path) -> None:
    whole = _with_files(gap, tmp_path / "ep_000003", SCENE_CAMERA, range(12))
    _, taken = photos_in_parts([whole], None)
    assert [one.frame for one in taken] == list(range(12))
    assert [one.frame for one in select_photos(taken, 12)] == list(range(12))
    assert [one.frame for one in select_photos(taken, 4)] == [0, 6, OFF, 11]
    assert [one.frame for one in select_photos(taken, 1)] == [OFF]


def test_the_camera_that_stands_still_is_taken_unless_another_is_named(gap: MotionGap, tmp_path: Path) -> None:
    episode = tmp_path / "ep_000004"
    both = _with_files(_with_files(gap, episode, "a_wrist_camera", range(12)), episode, SCENE_CAMERA, range(3))
    assert photos_in_parts([both], None)[0] == SCENE_CAMERA
    assert len(photos_in_parts([both], "a_wrist_camera")[1]) == 12
    with pytest.raises(UsageError, match="no recording has it; valid: a_wrist_camera, scene_camera"):
        photos_in_parts([both], "other")
    with pytest.raises(UsageError, match="no recording has photos"):
        photos_in_parts([replace(gap, name="a.csv")], None)
