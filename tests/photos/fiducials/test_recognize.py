"""Unreadable boards: candidates, their reliability, and where boards are searched."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from tests.board_photos import CAMERA, ONE, TWO, facing, photograph, picture, pose_error, with_noise
from tests.strangers import KINDS, stranger
from yamsim_cli.camera_effects.lens_distortion import project_points
from yamsim_cli.core.geometry.board import Board
from yamsim_cli.core.geometry.se3 import Array, invert_pose, pose, rotation_from_vector
from yamsim_cli.photos.fiducials.board_detection import BoardStatus
from yamsim_cli.photos.fiducials.board_localization import locate_boards
from yamsim_cli.photos.fiducials.fitting.blur_kernel import BlurKernel
from yamsim_cli.photos.fiducials.fitting.print_view import PrintedBoard, crop_photo_to_print, print_plane
from yamsim_cli.photos.fiducials.recognition.board_candidates import (
    board_quads,
    dark_quads,
    edge_quads,
    oriented_candidates,
    refine_candidates,
)
from yamsim_cli.photos.fiducials.recognition.marker_bits import (
    marker_bits,
    measure_bit_agreement,
    most_significant_markers,
)


def corners_of(board: Board, T: Array) -> Array:
    return project_points(CAMERA, board.outer_corners() @ T[:3, :3].T + T[:3, 3])


def chance(photo: np.ndarray, board: Board, T: Array) -> float:
    piece = PrintedBoard(board, np.eye(4), tuple(range(9)))
    plane = print_plane(piece, T)
    view = crop_photo_to_print(photo.astype(np.float32), CAMERA, piece, plane)
    return measure_bit_agreement(view, plane, BlurKernel(0.6), 2.0).log_chance_bound


def test_the_bits_of_a_far_board_are_no_chance() -> None:
    truth = facing(0.1, 0.05, 1.4)
    photo = photograph(CAMERA, [(ONE, truth)])
    assert chance(photo, ONE, truth) < -80
    # Another board, a rotated one, and a place beside it agree by chance only.
    turned = truth @ pose((0, 0, 0), [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    for board, T in ((TWO, truth), (ONE, turned), (ONE, truth @ pose((0.03215, 0, 0)))):
        assert chance(photo, board, T) > -12


def test_chance_is_bounded_as_it_says() -> None:
    """At most the bound's share of random bits agrees so well, whichever markers are chosen."""
    rng = np.random.default_rng(0)
    bits = marker_bits(ONE)
    found = []
    for _ in range(4000):
        values = rng.normal(size=bits.shape)
        values /= np.linalg.norm(values, axis=1, keepdims=True)
        tossed = rng.choice([-1.0, 1.0], bits.shape)
        found.append(most_significant_markers({k: float(values[k] @ tossed[k]) for k in range(9)})[0])
    for log_chance in (-1.0, -2.0, -3.0, -4.0):
        assert np.mean(np.array(found) < log_chance) <= math.exp(log_chance)
    assert most_significant_markers({0: 6.0, 1: 6.0, 2: 6.0, 3: -1.0})[1] == (0, 1, 2)


@pytest.mark.parametrize("where", [(0.1, 0.05, 1.4, 0.2, 0.1), (-0.1, 0.0, 1.1, 1.0, 0.3)])
def test_a_dark_patch_on_a_light_table_is_a_suspect(where: tuple[float, ...]) -> None:
    truth = facing(*where)
    photo = photograph(CAMERA, [(ONE, truth)])
    found = oriented_candidates(photo, ONE, dark_quads(photo, whole=True))
    cell = np.sqrt(cv2.contourArea(corners_of(ONE, truth).astype(np.float32))) / 26
    assert np.abs(found[0].corners - corners_of(ONE, truth)).max() < 2 * cell
    assert found[0].agreement > 6


def test_on_a_dark_table_the_grid_of_markers_is_one() -> None:
    truth = facing(0.05, 0.05, 0.9)
    photo = photograph(CAMERA, [(ONE, truth)], noise=0.0)
    dark = np.where(photo == 150, 40, photo).astype(np.uint8)
    # A hand covers two of the markers.
    corners = corners_of(ONE, truth)
    cv2.circle(dark, tuple(np.round(corners[0]).astype(int).tolist()), 16, 90, -1)
    grids = board_quads(dark_quads(dark, whole=False), ONE)
    found = oriented_candidates(dark, ONE, grids)
    assert found[0].agreement > 6
    assert np.abs(found[0].corners - corners).max() < 4
    (seen,), _ = locate_boards(dark, CAMERA, [ONE])
    assert pose_error(seen.T_board_in_cam, truth)[1] < math.radians(1)


def test_on_ground_that_is_darker_than_its_print_a_board_is_a_patch_full_of_edges() -> None:
    truth = facing(0.1, 0.05, 1.15, 1.0, 0.3)
    clean, corners = picture(CAMERA, [(ONE, truth)], 0.4), corners_of(ONE, truth)
    inside = np.zeros(clean.shape, np.uint8)
    cv2.fillConvexPoly(inside, np.round(corners * 16).astype(np.int32), 1, cv2.LINE_8, 4)
    clean = np.where(inside > 0, clean, 0.55 * clean[inside > 0].mean()).astype(np.float32)
    # Other objects give the photo its range of brightness.
    clean[:, :60], clean[:60] = 20, 230
    photo = with_noise(clean)
    assert not oriented_candidates(photo, ONE, dark_quads(photo, whole=True))
    assert not oriented_candidates(photo, ONE, board_quads(dark_quads(photo, whole=False), ONE))
    (found, *_) = refine_candidates(photo, ONE, edge_quads(photo))
    assert np.abs(found.corners - corners).max() < 1
    (seen,), _ = locate_boards(photo, CAMERA, [ONE])
    assert pose_error(seen.T_board_in_cam, truth)[1] < math.radians(0.2)


@pytest.mark.slow
def test_another_board_tells_two_poses_apart() -> None:
    """The photo alone hardly does; nor does a rig with neither of the two poses."""
    truth, apart = facing(-0.15, 0.0, 1.3, 0.2, 0.0), pose((0.3, 0.0, 0.0))
    photo = photograph(CAMERA, [(ONE, truth), (TWO, truth @ apart)], blur=2.0, noise=3.0)
    alone, _ = locate_boards(photo, CAMERA, [ONE, TWO])
    assert alone[0].status is BoardStatus.AMBIGUOUS and alone[1].status is BoardStatus.OK
    told, _ = locate_boards(photo, CAMERA, [ONE, TWO], [np.eye(4), apart])
    assert pose_error(told[0].T_board_in_cam, truth)[1] < math.radians(3)
    tilted = apart @ pose((0, 0, 0), rotation_from_vector([math.radians(-13), 0, 0]))
    untold, _ = locate_boards(photo, CAMERA, [ONE, TWO], [np.eye(4), tilted])
    assert untold[0].status is BoardStatus.AMBIGUOUS


def test_beside_a_board_that_is_seen_the_other_is_looked_for() -> None:
    """It merges with a dark object beside it, and its markers are too small: the rig says where to search."""
    apart = pose((0.3, 0.0, 0.0))
    truth = facing(-0.15, 0.0, 1.0, 0.9)
    photo = photograph(CAMERA, [(ONE, truth), (TWO, truth @ apart)], blur=2.0)
    corners = corners_of(TWO, truth @ apart)
    right = int(corners[:, 0].max())
    photo[:, right - 8 :] = 35
    photo[int(corners[:, 1].max()) - 4 :, right - 90 :] = 35
    alone, _ = locate_boards(photo, CAMERA, [ONE, TWO])
    assert alone[0].status is BoardStatus.OK and alone[1].status is BoardStatus.NOT_FOUND
    # Approximately so; and nearly there in the photo before.
    near = pose((0.004, -0.003, 0.002))
    beside, _ = locate_boards(photo, CAMERA, [ONE, TWO], [np.eye(4), apart @ near])
    before, _ = locate_boards(photo, CAMERA, [ONE, TWO], before=[None, truth @ apart @ near])
    for seen in (beside[1], before[1]):
        assert seen.T_board_in_cam is not None, seen.failure_explanation
        shift, turn = pose_error(seen.T_board_in_cam, truth @ apart)
        assert shift < 0.015 and turn < math.radians(3)


def test_the_same_print_twice_is_refused_even_if_it_cannot_be_read() -> None:
    one, two = facing(-0.2, 0.0, 1.5), facing(0.2, 0.05, 1.5)
    (seen,), _ = locate_boards(photograph(CAMERA, [(ONE, one), (ONE, two)], blur=1.3), CAMERA, [ONE])
    assert seen.status is BoardStatus.AMBIGUOUS and seen.T_board_in_cam is None


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_unknown_prints_are_not_recognized_as_a_board(kind: str) -> None:
    for k in range(2):
        photo = stranger(np.random.default_rng([1, k]), kind, ONE)
        for seen in locate_boards(photo, CAMERA, [ONE, TWO], [np.eye(4), invert_pose(pose((0.3, 0, 0)))])[0]:
            assert seen.T_board_in_cam is None
            assert seen.advice or seen.is_duplicated


@pytest.mark.parametrize(
    ("spoil", "part"),
    [({"light": 0.1}, "add light"), ({"blur": 9.0}, "focus"), ({}, "bring the whole board into the photo")],
    ids=["dark", "blurred", "absent"],
)
def test_advice_is_given_for_dark_blurred_and_absent_boards(spoil: dict[str, float], part: str) -> None:
    boards = (
        [(ONE, facing(0, 0, 0.35))]
        if spoil
        else [(Board("other", 100, 3, 3, "DICT_4X4_250", ONE.marker_length, ONE.gap), facing(0, 0, 0.5))]
    )
    photo = photograph(CAMERA, boards, blur=spoil.get("blur", 0.6), noise=4.0)
    photo = (photo * spoil.get("light", 1.0)).astype(np.uint8)
    (seen,), _ = locate_boards(photo, CAMERA, [TWO])
    assert seen.T_board_in_cam is None
    assert any(part in one for one in seen.advice), seen.advice
    assert part in seen.failure_explanation
