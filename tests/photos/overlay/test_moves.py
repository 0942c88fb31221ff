"""Moves of a camera or base between photos, from poses with known truth."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array, invert_pose, pose, rotation_from_vector
from yamsim_cli.photos.fiducials.board_detection import BoardDetection, BoardStatus
from yamsim_cli.photos.overlay.move_detection import MovedBody, MoveReport, find_moves
from yamsim_cli.photos.overlay.photo_arm_poses import ArmBasePose, RigInPhoto
from yamsim_cli.photos.overlay.photo_cameras import PhotoCamera

LENS = PhotoCamera.from_calibration(CameraModel.from_focal_length(640, 480, 600.0), "file")
T_CAM_IN_WORLD = pose(
    (-0.3, 0.0, 0.9), rotation_from_vector((math.radians(150), 0, 0)) @ rotation_from_vector((0, 0, 0.2))
)


@dataclass(frozen=True)
class Series:
    """A series of photos with moves.

    Attributes:
        camera, bases: number of a photo -> motion (4, 4) of the camera, or of base `arm`, before it.
        unseen: (photo, arm) whose board has no pose.
        wrong: (photo, arm) whose pose is off by 5 cm.
    """

    photos: int = 40
    camera: Mapping[int, Array] = field(default_factory=dict)
    bases: Mapping[tuple[int, int], Array] = field(default_factory=dict)
    unseen: frozenset[tuple[int, int]] = frozenset()
    wrong: frozenset[tuple[int, int]] = frozenset()
    noise_m: float = 1e-4
    noise_rad: float = 3e-4

    def told(self, rig: RigConfig, seed: int = 0) -> MoveReport:
        rng = np.random.default_rng(seed)
        T_cam, T_bases = T_CAM_IN_WORLD, [rig.T_base_in_world(k) for k in range(len(rig.arms))]
        results = []
        for number in range(self.photos):
            T_cam = T_cam @ self.camera.get(number, np.eye(4))
            T_bases = [T @ self.bases.get((number, k), np.eye(4)) for k, T in enumerate(T_bases)]
            results.append(self._photo(number, [invert_pose(T_cam) @ T for T in T_bases], rig, rng))
        return find_moves(results)

    def _photo(self, number: int, bases: list[Array], rig: RigConfig, rng: np.random.Generator) -> RigInPhoto:
        arms = []
        for k, (arm, T_base_in_cam) in enumerate(zip(rig.arms, bases, strict=True)):
            if (number, k) in self.unseen:
                gone = BoardDetection(arm.board.board_in_metres, (), BoardStatus.NOT_FOUND, "nothing there")
                arms.append(ArmBasePose(arm.name, arm.board.name, "not_found", gone))
                continue
            shift = rng.normal(0, self.noise_m, 3) + (0.05 if (number, k) in self.wrong else 0.0)
            T_board = T_base_in_cam @ arm.T_board_in_base
            turn = rotation_from_vector(rng.normal(0, self.noise_rad, 3))
            seen = pose(T_board[:3, 3] + shift, turn @ T_board[:3, :3])
            sighting = BoardDetection(arm.board.board_in_metres, (1, 2, 3), BoardStatus.OK, T_board_in_cam=seen)
            arms.append(ArmBasePose(arm.name, arm.board.name, "ok", sighting, seen @ invert_pose(arm.T_board_in_base)))
        return RigInPhoto(Path(f"{number:03d}.png"), LENS, "file", tuple(arms), (), time=number / 10)


def by(x: float = 0.0, y: float = 0.0, z: float = 0.0, turn_deg: float = 0.0) -> Array:
    return pose((x, y, z), rotation_from_vector((0, 0, math.radians(turn_deg))))


def test_no_moves_are_found_where_nothing_moved(russet: RigConfig) -> None:
    for seed in range(20):
        stillness = Series().told(russet, seed)
        assert stillness.moves == ()
        assert stillness.why_unknown == ""


def test_a_base_that_moved_is_told_with_its_arm_photo_and_shift(russet: RigConfig) -> None:
    (move,) = Series(bases={(17, 1): by(y=0.003)}).told(russet).moves
    assert (move.photo, move.path, move.time, move.what, move.arm) == (17, Path("017.png"), 1.7, MovedBody.BASE, "arm2")
    np.testing.assert_allclose(move.shift_in_base, (0, 0.003, 0), atol=4 * move.shift_sigma)
    assert move.shift == pytest.approx(0.003, abs=3e-4)
    assert move.shift_sigma < 3e-4


def test_a_turned_base_is_told_by_its_turn(russet: RigConfig) -> None:
    (move,) = Series(bases={(20, 0): by(turn_deg=0.5)}).told(russet).moves
    assert (move.what, move.arm) == (MovedBody.BASE, "arm1")
    assert math.degrees(move.turn) == pytest.approx(0.5, abs=0.05)


def test_a_camera_that_moved_is_told_once_by_its_own_motion(russet: RigConfig) -> None:
    (move,) = Series(camera={12: by(x=0.004, turn_deg=0.3)}).told(russet).moves
    assert (move.photo, move.what) == (12, MovedBody.CAMERA)
    assert move.shift == pytest.approx(0.004, abs=4 * move.shift_sigma)
    assert math.degrees(move.turn) == pytest.approx(0.3, abs=0.05)


def test_moves_of_camera_and_base_one_after_the_other_are_both_found(russet: RigConfig) -> None:
    stillness = Series(camera={12: by(x=0.01)}, bases={(28, 1): by(x=-0.005)}).told(russet)
    assert [(move.photo, move.what) for move in stillness.moves] == [(12, MovedBody.CAMERA), (28, MovedBody.BASE)]


def test_both_bases_at_once_are_several_moves(russet: RigConfig) -> None:
    stillness = Series(bases={(15, 0): by(x=0.01), (15, 1): by(y=0.02)}).told(russet)
    assert {(move.photo, move.what, move.arm) for move in stillness.moves} == {
        (15, MovedBody.SEVERAL, "arm1"),
        (15, MovedBody.SEVERAL, "arm2"),
    }


def test_one_board_in_sight_leaves_open_what_moved(russet: RigConfig) -> None:
    unseen = frozenset((number, 1) for number in range(40))
    (move,) = Series(camera={20: by(x=0.005)}, unseen=unseen).told(russet).moves
    assert (move.what, move.arm) == (MovedBody.CAMERA_OR_BASE, "arm1")


def test_wrong_poses_and_photos_without_one_are_no_moves(russet: RigConfig) -> None:
    series = Series(wrong=frozenset({(5, 0), (6, 0), (30, 1)}), unseen=frozenset({(10, 0), (11, 0), (20, 1)}))
    assert series.told(russet).moves == ()
    moved = Series(bases={(15, 0): by(x=0.003)}, wrong=series.wrong, unseen=series.unseen).told(russet)
    assert [(move.photo, move.what) for move in moved.moves] == [(15, MovedBody.BASE)]


@pytest.mark.parametrize("photos", [9, 40])
def test_no_moves_are_reported_for_a_handheld_camera(russet: RigConfig, photos: int) -> None:
    carried = {number: by(x=0.02, turn_deg=1.0) for number in range(photos)}
    stillness = Series(photos, camera=carried).told(russet)
    assert stillness.moves == ()
    assert "not on a stand" in stillness.why_unknown


def test_no_moves_are_reported_for_few_photos(russet: RigConfig) -> None:
    assert "fewer than 8 photos" in Series(photos=7, camera={3: by(x=0.1)}).told(russet).why_unknown
