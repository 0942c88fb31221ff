"""The truth loop of `make bench-fiducials`, in small: photos from known poses, located by the same code."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from tests.board_photos import pose_error
from tests.truth_photos import CAMERA, Photographer, shot_of, spoilt
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array, invert_pose
from yamsim_cli.photos.fiducials.board_detection import BoardDetection, BoardStatus
from yamsim_cli.photos.fiducials.board_localization import locate_boards
from yamsim_cli.photos.fiducials.focal_length.focal_estimate import FocalEstimate, estimate_focal, find_outlines

pytestmark = pytest.mark.render

TILT = (0.0, math.radians(60))


@pytest.fixture(scope="module")
def russet(locations: Locations) -> Iterator[Photographer]:
    with Photographer("russet", locations) as photographer:
        yield photographer


def errors(seen: BoardDetection, truth: Array) -> tuple[float, float]:
    """Errors of the centre, mm, and of the orientation, degrees."""
    assert seen.T_board_in_cam is not None, seen.reason
    shift, turn = pose_error(seen.T_board_in_cam, truth)
    return shift * 1000, math.degrees(turn)


def photo_of(photographer: Photographer, rng: np.random.Generator, distance: float, which: int = 0):
    """A clean picture of one board, and the truth."""
    T_cam = shot_of(photographer, rng, distance, TILT, which)
    return photographer.take(), invert_pose(T_cam) @ photographer.boards[which].T_in_world


@pytest.mark.slow
@pytest.mark.parametrize(("distance", "mm", "deg"), [(0.4, 0.2, 0.2), (0.8, 0.5, 0.4), (1.0, 1.5, 0.8)])
def test_located_boards_match_their_true_poses(russet: Photographer, distance: float, mm: float, deg: float) -> None:
    rng = np.random.default_rng([1, round(distance * 10)])
    for k in range(4):
        image, truth = photo_of(russet, rng, distance, k % 2)
        (seen,), _ = locate_boards(spoilt(image, rng), CAMERA, [russet.boards[k % 2].board])
        off_mm, off_deg = errors(seen, truth)
        assert off_mm < mm
        assert off_deg < deg
        assert seen.reprojection_rms is not None and seen.reprojection_rms < 0.1
        assert seen.position_sigma is not None and off_mm < 3000 * seen.position_sigma
        assert seen.markers == russet.boards[k % 2].board.marker_ids


@pytest.mark.slow
@pytest.mark.parametrize(
    "spoil", [{"noise": 20.0}, {"jpeg": 50}, {"light": 0.1}, {"blur": 1.2}], ids=["noise", "jpeg", "dark", "blur"]
)
def test_poor_photos_are_still_right(russet: Photographer, spoil: dict) -> None:
    rng = np.random.default_rng(4)
    for _ in range(2):
        image, truth = photo_of(russet, rng, 0.6)
        (seen,), _ = locate_boards(spoilt(image, rng, **spoil), CAMERA, [russet.boards[0].board])
        off_mm, off_deg = errors(seen, truth)
        assert off_mm < 2.0
        assert off_deg < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("spoil", [{"blur": 9.0}, {"motion": 60.0}, {"light": 0.01}], ids=["blur", "motion", "dark"])
def test_useless_photos_are_refused(russet: Photographer, spoil: dict) -> None:
    rng = np.random.default_rng(5)
    for _ in range(2):
        image, _ = photo_of(russet, rng, 0.9)
        (seen,), _ = locate_boards(spoilt(image, rng, **spoil), CAMERA, [russet.boards[0].board])
        assert seen.status is not BoardStatus.OK
        assert seen.T_board_in_cam is None and seen.reason and seen.advice


@pytest.mark.slow
@pytest.mark.parametrize(
    ("distance", "spoil"), [(1.3, {}), (0.8, {"blur": 3.0}), (0.8, {"motion": 10.0})], ids=["far", "blur", "motion"]
)
def test_what_cannot_be_read_is_recognized(russet: Photographer, distance: float, spoil: dict) -> None:
    """Found with the stated uncertainty; single photos may be refused, but not most of them."""
    rng = np.random.default_rng(8)
    found = 0
    for k in range(3):
        image, truth = photo_of(russet, rng, distance, k % 2)
        (seen,), _ = locate_boards(spoilt(image, rng, **spoil), CAMERA, [russet.boards[k % 2].board])
        if seen.T_board_in_cam is None:
            continue
        found += 1
        off_mm, off_deg = errors(seen, truth)
        assert off_mm < 15.0 and off_deg < 3.0
        assert seen.rotation_sigma is not None and off_deg < 2 * math.degrees(seen.rotation_sigma)
        assert seen.blur is not None and abs(seen.blur.motion_length - spoil.get("motion", 0.0)) < 3.0
    assert found >= 2


def focal_of(photo: np.ndarray, boards: list) -> FocalEstimate:
    return estimate_focal(find_outlines(photo, boards), (CAMERA.width, CAMERA.height))


def test_the_focal_length_is_found_as_well_as_it_says(russet: Photographer) -> None:
    rng = np.random.default_rng(6)
    for _ in range(2):
        shot_of(russet, rng, 0.8, (math.radians(25), math.radians(55)))
        found = focal_of(spoilt(russet.take(), rng), [placed.board for placed in russet.boards])
        assert found.reason == "" and found.camera.focal_sigma < 0.06
        assert found.low < CAMERA.mean_focal_length < found.high
