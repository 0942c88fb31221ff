"""Selection of photos and masks, and data of a recorded episode's frames."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.dataset.lowdim import dump_frame, make_frame
from yamsim_cli.core.errors import ConfigError, DatasetError, ResourceError, UsageError
from yamsim_cli.core.geometry.se3 import invert_pose, pose, rotation_z
from yamsim_cli.photos.overlay.photos import (
    PlacedCamera,
    episode_photos,
    find_mask,
    find_photos,
    pinhole_camera,
)

JOINTS = [0.3, 1.2, 1.0, -0.2, 0.1, 0.4, 0.02]
K = [[60.0, 0, 31.5], [0, 60.0, 23.5], [0, 0, 1]]
T_CAM = pose((0.5, 0.1, 0.7), rotation_z(0.4))


def touch(*paths: Path) -> None:
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")


def test_files_and_folders_in_order_each_once(tmp_path: Path) -> None:
    inside = [tmp_path / "d" / name for name in ("a.png", "b.JPG", "c.jpeg")]
    touch(tmp_path / "z.png", *inside)
    found = find_photos([tmp_path / "z.png", tmp_path / "d", inside[0], tmp_path / "d" / ".." / "z.png"])
    assert found == [tmp_path / "z.png", *inside]


def test_what_in_a_folder_is_no_photo(tmp_path: Path) -> None:
    touch(
        *(tmp_path / name for name in ("a.png", "a_overlay.png", "a_mask.png", "._a.png", ".b.png", "n.txt", "r.gif"))
    )
    (tmp_path / "folder.png").mkdir()
    touch(tmp_path / "deeper" / "c.png")
    assert find_photos([tmp_path]) == [tmp_path / "a.png"]
    # An explicit name is used.
    assert find_photos([tmp_path / "a_mask.png"]) == [tmp_path / "a_mask.png"]


@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("empty", "contains no photo; valid: .png, .jpg, .jpeg"),
        ("none.png", "does not exist"),
        ("a.txt", "is not a photo"),
    ],
)
def test_missing_photos_are_refused_in_one_line(tmp_path: Path, name: str, part: str) -> None:
    (tmp_path / "empty").mkdir()
    touch(tmp_path / "empty" / "a_overlay.png", tmp_path / "a.txt")
    with pytest.raises(ResourceError, match=part):
        find_photos([tmp_path / name])


def test_a_photos_mask_is_found_by_its_name(tmp_path: Path) -> None:
    photo = tmp_path / "photos" / "a.jpg"
    masks = tmp_path / "masks"
    touch(photo, masks / "b_mask.png")
    assert find_mask(masks / "b_mask.png", photo) == masks / "b_mask.png"
    with pytest.raises(ResourceError, match=r"contains no mask for a\.jpg; valid: a_mask\.png or a\.png"):
        find_mask(masks, photo)
    for name in ("a.jpg", "a.png", "a_mask.png"):
        touch(masks / name)
        assert find_mask(masks, photo) == masks / name


def test_a_photo_is_not_its_own_mask(tmp_path: Path) -> None:
    touch(tmp_path / "a.png")
    with pytest.raises(ResourceError, match=r"a_mask\.png"):
        find_mask(tmp_path, tmp_path / "a.png")


def frame(**changes: Any) -> dict[str, Any]:
    cameras = ("scene_camera", "right_wrist_camera")
    data = make_frame(
        joints=np.array([JOINTS]),
        timestamp=0.0,
        intrinsics=dict.fromkeys(cameras, K),
        extrinsics={"scene_camera": T_CAM, "right_wrist_camera": np.eye(4)},
        object_poses={},
        ee_pose=np.eye(4)[None],
        ctrl=np.zeros((1, 7)),
        action_joints=np.zeros((1, 7)),
        magnet=np.array([False]),
        language_task="t",
        language_prompt="p",
    )
    return data | changes


@pytest.fixture
def episode(tmp_path: Path) -> Path:
    path = tmp_path / "ep_000000"
    for camera in ("right_wrist_camera", "scene_camera"):
        (path / "rgb" / camera).mkdir(parents=True)
        for k in range(3):
            cv2.imwrite(str(path / "rgb" / camera / f"{k:06d}.jpg"), np.full((48, 64, 3), 90, np.uint8))
    (path / "lowdim").mkdir()
    for k in range(3):
        (path / "lowdim" / f"{k:06d}.pkl").write_bytes(dump_frame(frame(joints=np.array(JOINTS) + 0.01 * k)))
    return path


def test_an_episode_knows_its_camera_its_pose_and_its_joints(episode: Path, single: RigConfig) -> None:
    photos = episode_photos(episode, None, single)
    assert [photo.path.name for photo in photos] == ["000000.jpg", "000001.jpg", "000002.jpg"]
    assert {photo.path.parent.name for photo in photos} == {"scene_camera"}
    last = photos[2]
    assert (last.camera.width, last.camera.height, last.camera.mean_focal_length) == (64, 48, 60.0)
    (stand,) = last.postures
    assert [*stand.joints, stand.opening] == pytest.approx(np.array(JOINTS) + 0.02, abs=1e-6)
    assert last.joints_source == "episode"
    assert last.T_base_in_cam == pytest.approx(invert_pose(T_CAM), abs=1e-6)
    assert photos[0].camera == last.camera


def test_another_camera_of_the_episode(episode: Path, single: RigConfig) -> None:
    photo = episode_photos(episode, "right_wrist_camera", single)[0]
    assert photo.path.parent.name == "right_wrist_camera"
    assert photo.T_base_in_cam == pytest.approx(np.eye(4))
    with pytest.raises(UsageError, match="has no camera 'scene_cam'; did you mean 'scene_camera'"):
        episode_photos(episode, "scene_cam", single)


def test_a_calibrated_camera_replaces_what_is_recorded(episode: Path, single: RigConfig) -> None:
    for k in range(3):
        data = frame(joints=np.array(JOINTS) + 0.01 * k, timestamp=0.1 * k)
        del data["intrinsics"], data["extrinsics"]
        (episode / "lowdim" / f"{k:06d}.pkl").write_bytes(dump_frame(data))
    camera = pinhole_camera(np.diag([50.0, 50.0, 1.0]), 64, 48)
    offsets = np.array([0.0, 0.02, 0.0, 0.0, 0.0, -0.01])
    placed = PlacedCamera(camera, (pose((0.0, 0.0, 1.0)),), (offsets,), 0.05)
    photo = episode_photos(episode, None, single, placed)[2]
    assert (photo.camera, photo.placed, photo.T_base_in_cam) == (camera, placed, None)
    # The photo shows the arm 0.05 s before its time stamp, between the second and the third frame.
    assert photo.postures[0].joints == pytest.approx(np.array(JOINTS[:6]) + 0.015 - offsets, abs=1e-6)
    (episode / "lowdim" / "000001.pkl").write_bytes(b"no frame")
    with pytest.raises(DatasetError, match=r"000001\.pkl: cannot be used"):
        episode_photos(episode, None, single, placed)


@pytest.mark.parametrize(
    ("data", "part"),
    [
        (b"\x80\x04", "not a valid pickle"),
        (pickle.dumps({"joints": print}), "print"),
        (dump_frame(frame(joints=np.zeros(5))), "(5,)"),
        (dump_frame(frame(extrinsics={})), "has no 'scene_camera' of camera scene_camera; to use the images alone"),
        (dump_frame(frame(intrinsics={"scene_camera": np.eye(4)})), "shape (4, 4) or is not finite; valid: (3, 3)"),
        (dump_frame(frame(extrinsics={"scene_camera": np.full((4, 4), np.nan)})), "not finite"),
        (dump_frame(frame(extrinsics=3)), "cannot be used"),
    ],
)
def test_a_damaged_frame_is_one_line(episode: Path, single: RigConfig, data: bytes, part: str) -> None:
    (episode / "lowdim" / "000001.pkl").write_bytes(data)
    with pytest.raises((DatasetError, ConfigError)) as caught:
        episode_photos(episode, None, single)
    assert "000001.pkl" in str(caught.value)
    assert part in str(caught.value)
    assert "\n" not in str(caught.value)


def test_folders_that_are_not_episodes_are_refused(episode: Path, single: RigConfig, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="is not an episode: it needs rgb/ and lowdim/; give DATASET/ep_NNNNNN"):
        episode_photos(tmp_path, None, single)
    (episode / "lowdim" / "000002.pkl").unlink()
    with pytest.raises(DatasetError, match=r"000002\.pkl: cannot be read: No such file"):
        episode_photos(episode, None, single)
    for path in (episode / "rgb" / "scene_camera").iterdir():
        path.unlink()
    with pytest.raises(DatasetError, match="scene_camera contains no image"):
        episode_photos(episode, None, single)


def test_an_episode_of_one_arm_does_not_show_two(episode: Path, russet: RigConfig) -> None:
    with pytest.raises(ConfigError, match=r"000000\.pkl: .*\(7,\).*'russet'"):
        episode_photos(episode, None, russet)
