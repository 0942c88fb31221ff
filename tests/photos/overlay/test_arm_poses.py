"""From boards to base poses: one by one, together, from one to the other; and their margin."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.board_photos import CAMERA, facing, photograph, picture, scaled_camera, with_noise
from yamsim_cli.camera_effects.lens_distortion import project_points
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.geometry.se3 import Array, invert_pose, pose
from yamsim_cli.photos.overlay.photo_arm_poses import RigInPhoto, find_arms
from yamsim_cli.photos.overlay.photo_cameras import PhotoCamera, estimate_camera
from yamsim_cli.photos.overlay.photos import Photo

# Both boards lie between the arms: the middle of the rig, slightly rotated.
T_WORLD_IN_CAM = facing(0.0, 0.0, 0.75, 0.6, 0.15)
PHOTO = Photo(Path("p.png"))


def boards_of(rig: RigConfig, which: tuple[int, ...] = (0, 1)) -> list:
    """The rig's boards with their poses in the camera's frame."""
    placed = []
    for k in which:
        board = rig.arms[k].board
        placed.append((board.board_in_metres, T_WORLD_IN_CAM @ rig.T_base_in_world(k) @ rig.arms[k].T_board_in_base))
    return placed


@pytest.fixture(scope="module")
def clean(russet: RigConfig) -> np.ndarray:
    return picture(CAMERA, boards_of(russet))


def base(rig: RigConfig, k: int) -> Array:
    return T_WORLD_IN_CAM @ rig.T_base_in_world(k)


def shift_mm(result: RigInPhoto, rig: RigConfig, k: int) -> float:
    T = result.arms[k].T_base_in_cam
    return float(np.linalg.norm(T[:3, 3] - base(rig, k)[:3, 3])) * 1000


def found(rig: RigConfig, grey: np.ndarray, trust: bool = False, photo: Photo = PHOTO) -> RigInPhoto:
    return find_arms(rig, photo, grey, PhotoCamera.from_calibration(CAMERA, "file"), trust)


def test_each_arm_is_located_by_its_own_board(russet: RigConfig, clean: np.ndarray) -> None:
    result = found(russet, with_noise(clean))
    assert [(arm.name, arm.board, arm.status) for arm in result.arms] == [
        ("arm1", "larger_coarse_board", "ok"),
        ("arm2", "larger_coarse_board_arm2", "ok"),
    ]
    assert max(shift_mm(result, russet, k) for k in (0, 1)) < 1.0
    assert result.ids == tuple(range(217, 235))
    assert result.notes == ()
    assert set(result.base_poses) == {0, 1}


def test_the_margin_is_measured_with_its_uncertainty(russet: RigConfig, clean: np.ndarray) -> None:
    result = found(russet, with_noise(clean))
    assert result.margin == pytest.approx(0.591, abs=0.0005)
    assert result.T_arm2_in_arm1[:3, 3] == pytest.approx((0, 0.591, 0), abs=0.002)
    # A quarter of a percent of the 24 cm between the boards, for the print's size; noise is far smaller.
    assert result.margin_sigma == pytest.approx(0.0006, abs=0.0002)


@pytest.mark.slow
@pytest.mark.parametrize("trust", [False, True])
def test_a_wrong_margin_in_the_rig_is_told(russet: RigConfig, clean: np.ndarray, trust: bool) -> None:
    grey = with_noise(clean)
    for off, told in ((0.0, False), (0.001, False), (0.005, True), (-0.005, True)):
        wrong = russet.model_copy(update={"margin": 0.591 + off})
        result = found(wrong, grey, trust)
        assert result.margin == pytest.approx(0.591, abs=0.0005)
        assert any("correct the rig's margin, or measure the prints" in note for note in result.notes) == told
        if told:
            note = next(note for note in result.notes if "margin" in note)
            assert f"the arms are {result.margin:.4f} m apart here (+- 0." in note
            assert f"and {0.591 + off:.4f} m in rig 'russet'" in note
        # A wrong margin is not followed, even if requested.
        assert max(shift_mm(result, russet, k) for k in (0, 1)) < (4.0 if off == 0.001 else 0.5)
        assert any("its margin is ignored" in note for note in result.notes) == (told and trust)


def test_together_the_arms_stand_as_the_rig_says(russet: RigConfig, clean: np.ndarray) -> None:
    grey = with_noise(clean, noise=6.0)
    alone, joint = found(russet, grey), found(russet, grey, trust=True)
    T_one, T_two = joint.arms[0].T_base_in_cam, joint.arms[1].T_base_in_cam
    assert invert_pose(T_one) @ T_two == pytest.approx(invert_pose(base(russet, 0)) @ base(russet, 1), abs=1e-9)
    # The measured values stay.
    assert (joint.margin, joint.margin_sigma) == (alone.margin, alone.margin_sigma)
    # Each marker may be 0.03 mm off its place on the print, so noise moves a pose 1.5 times as far as for exact prints.
    assert max(shift_mm(joint, russet, k) for k in (0, 1)) < 0.5
    assert max(shift_mm(joint, russet, k) for k in (0, 1)) < max(shift_mm(alone, russet, k) for k in (0, 1))


@pytest.mark.slow
@pytest.mark.parametrize("visible", [0, 1])
def test_an_arm_whose_board_is_hidden_is_inferred_only_when_the_margin_is_trusted(
    russet: RigConfig, visible: int
) -> None:
    grey = photograph(CAMERA, boards_of(russet, (visible,)))
    hidden = 1 - visible
    alone = found(russet, grey)
    assert alone.arms[hidden].status == "not_found"
    assert alone.arms[hidden].T_base_in_cam is None
    assert alone.margin is None
    result = found(russet, grey, trust=True)
    assert [result.arms[k].status for k in (visible, hidden)] == ["ok", "inferred"]
    # The other arm stands 0.6 m away: a rotation of a thousandth matters there.
    assert shift_mm(result, russet, visible) < 1.0
    assert shift_mm(result, russet, hidden) < 3.0
    assert result.margin is None


def test_a_board_is_looked_for_where_the_photo_before_had_it(russet: RigConfig) -> None:
    """Blurred, and covered on two sides as dark as itself: the cover of its outer markers does not pull its pose."""
    ((board, T_before),) = boards_of(russet, (0,))
    before = found(russet, photograph(CAMERA, [(board, T_before)]))
    T = pose((0.003, -0.004, 0.002)) @ T_before
    grey = photograph(CAMERA, [(board, T)], blur=2.0)
    corners = project_points(CAMERA, board.outer_corners() @ T[:3, :3].T + T[:3, 3])
    right, bottom = corners.max(axis=0).astype(int)
    grey[:, right - 6 :] = grey[bottom - 4 :] = 35
    assert found(russet, grey).arms[0].status == "not_found"
    result = find_arms(
        russet, PHOTO, grey, PhotoCamera.from_calibration(CAMERA, "file"), trust_margin=False, before=before
    )
    arm = result.arms[0]
    assert arm.status == "ok", arm.detection
    assert arm.T_base_in_cam @ russet.arms[0].T_board_in_base == pytest.approx(T, abs=1e-3)


def test_a_photo_without_boards_gives_no_pose(russet: RigConfig) -> None:
    result = found(russet, photograph(CAMERA, []), trust=True)
    assert (result.base_poses, result.ids) == ({}, ())
    assert [arm.status for arm in result.arms] == ["not_found", "not_found"]


def test_a_rig_without_boards_gives_no_pose(russet: RigConfig, clean: np.ndarray) -> None:
    bare = russet.model_copy(update={"arms": tuple(arm.model_copy(update={"board": None}) for arm in russet.arms)})
    result = found(bare, with_noise(clean))
    assert [(arm.board, arm.status) for arm in result.arms] == [(None, "no_board"), (None, "no_board")]


@pytest.mark.slow
def test_a_recorded_pose_stands_in_for_a_board_that_is_not_seen(russet: RigConfig, clean: np.ndarray) -> None:
    recorded = replace(PHOTO, T_base_in_cam=np.eye(4))
    result = found(russet, photograph(CAMERA, []), photo=recorded)
    assert [arm.status for arm in result.arms] == ["recorded", "recorded"]
    apart = np.linalg.inv(russet.T_base_in_world(0)) @ russet.T_base_in_world(1)
    assert result.arms[1].T_base_in_cam == pytest.approx(apart), "where the rig has it beside the first one"
    assert result.base_poses[0] == pytest.approx(np.eye(4))
    # A visible board is more accurate.
    assert found(russet, with_noise(clean), photo=recorded).arms[0].status == "ok"


@pytest.mark.slow
def test_a_print_that_is_not_as_the_rig_says_is_told(russet: RigConfig) -> None:
    """A slightly wrong print has its pose if seen well from nearby, with a note; other prints give no pose."""
    (board, T), other = boards_of(russet)
    large = scaled_camera(CAMERA, 3.0)
    near = photograph(large, [(replace(board, gap=1.12 * board.gap), facing(0.0, 0.0, 0.25, 0.9))])
    (note,) = find_arms(russet, PHOTO, near, PhotoCamera.from_calibration(large, "file"), trust_margin=False).notes
    assert note.startswith("arm1's markers lie ") and "marker_length_mm and gap_mm" in note
    far_off = found(russet, photograph(CAMERA, [(replace(board, gap=2 * board.gap), T), other]))
    assert [arm.status for arm in far_off.arms] == ["uncertain", "ok"]
    assert set(far_off.base_poses) == {1}
    refused = far_off.arms[0].detection
    assert "marker_length_mm or gap_mm" in refused.reason
    assert far_off.notes == ()


@pytest.mark.slow
def test_an_unknown_camera_of_several_photos(russet: RigConfig, clean: np.ndarray) -> None:
    """A photo without a board does no harm; photos are requested one after the other."""
    asked = []

    def images():
        for k, grey in enumerate([photograph(CAMERA, []), with_noise(clean), with_noise(clean, seed=1)]):
            asked.append(k)
            yield np.dstack([grey] * 3)

    lens = estimate_camera(images(), (480, 640), russet)
    assert (lens.camera.width, lens.camera.height) == (640, 480)
    assert lens.focal.low < 600 < lens.focal.high < 1.2 * lens.focal.low
    assert asked == [0, 1, 2]


@pytest.mark.parametrize("scale", [0.97, 1.02])
def test_a_print_of_another_size_is_told_by_the_other_board(russet: RigConfig, scale: float) -> None:
    """It looks too far away or too near, by 2 cm; which of both is correct cannot be known."""
    (one, T_one), (two, T_two) = boards_of(russet)
    printed = replace(two, marker_length=two.marker_length * scale, gap=two.gap * scale)
    grey = with_noise(picture(CAMERA, [(one, T_one), (printed, T_two)]))
    for trust in (False, True):
        result = found(russet, grey, trust)
        assert result.base_poses == {}
        for arm in result.arms:
            assert arm.status == "poor_fit"
            told = re.search(r"has ([\d.]+) % of its size in the rig", arm.detection.reason)
            assert float(told[1]) == pytest.approx(100 * scale, abs=0.15)
            assert "measure both prints" in arm.detection.reason


def test_arms_that_stand_elsewhere_have_no_print_of_another_size(russet: RigConfig) -> None:
    (one, T_one), (two, T_two) = boards_of(russet)
    for shift in ((0.0, 0.03, 0.0), (0.03, 0.0, 0.0)):
        T_moved = T_two.copy()
        T_moved[:3, 3] += T_two[:3, :3] @ shift
        result = found(russet, with_noise(picture(CAMERA, [(one, T_one), (two, T_moved)])))
        assert set(result.base_poses) == {0, 1}
