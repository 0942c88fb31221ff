"""Drawings over a photo hide as little as possible."""

from __future__ import annotations

import numpy as np
import pytest

from tests.board_photos import CAMERA, ONE, facing
from yamsim_cli.core.geometry.se3 import pose
from yamsim_cli.photos.picture_overlay import ARM_COLOURS, blend_arms, draw_board, write_lines


def grey_photo(height: int = 480, width: int = 640) -> np.ndarray:
    return np.full((height, width, 3), 100, np.uint8)


def test_arms_are_mixed_in_and_outlined_each_in_its_colour() -> None:
    drawn, labels = np.full((480, 640, 3), 200, np.uint8), np.zeros((480, 640), np.uint8)
    labels[100:200, 100:200], labels[300:400, 300:400] = 1, 2
    mixed = blend_arms(grey_photo(), drawn, labels, 0.5)
    assert mixed[150, 150].tolist() == mixed[350, 350].tolist() == [150] * 3
    assert mixed[50, 50].tolist() == [100] * 3
    for at, colour in (((150, 100), ARM_COLOURS[0]), ((350, 300), ARM_COLOURS[1])):
        assert np.abs(mixed[at].astype(int) - colour).max() < 40
    assert (blend_arms(grey_photo(), drawn, labels, 0.0)[120:180, 120:180] == 100).all()
    assert (blend_arms(grey_photo(), drawn, labels, 1.0)[120:180, 120:180] == 200).all()


def test_a_boards_axes_start_at_its_middle_and_go_where_they_point() -> None:
    """Straight below the camera: x to the right, y up in the picture, z at the camera."""
    image = grey_photo()
    draw_board(image, CAMERA, ONE, facing(0, 0, 0.5, 0, 0))
    changed = (image != 100).any(axis=2)
    half_px = 600 * ONE.width / 2 / 0.5
    rows, columns = np.nonzero(changed)
    assert (columns.min(), columns.max()) == pytest.approx((319.5 - half_px, 319.5 + half_px), abs=4)
    assert (rows.min(), rows.max()) == pytest.approx((239.5 - half_px, 239.5 + half_px), abs=4)
    red = (image[..., 0].astype(int) - image[..., 1] > 100) & (image[..., 0].astype(int) - image[..., 2] > 100)
    green = (image[..., 1].astype(int) - image[..., 0] > 80) & (image[..., 1].astype(int) - image[..., 2] > 80)
    assert np.nonzero(red)[1].mean() > 319.5 + half_px / 3
    assert np.nonzero(green)[0].mean() < 239.5 - half_px / 3


def test_a_board_behind_the_camera_is_not_drawn() -> None:
    image = grey_photo()
    draw_board(image, CAMERA, ONE, pose((0, 0, -0.5)))
    assert (image == 100).all()


@pytest.mark.parametrize("corner", [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_text_stands_in_the_corner_with_least_in_it(corner: tuple[int, int]) -> None:
    image, busy = grey_photo(), np.ones((480, 640), bool)
    free = np.s_[240 * corner[0] : 240 * (corner[0] + 1), 320 * corner[1] : 320 * (corner[1] + 1)]
    busy[free] = False
    write_lines(image, ["arm1: ok, 9/9 markers", "arm2: ok"], busy)
    written = (image != 100).any(axis=2)
    assert written[free].any()
    written[free] = False
    assert not written.any()


@pytest.mark.parametrize("size", [(144, 192), (240, 320), (480, 640), (3000, 4000), (40, 60)])
def test_text_fits_photos_of_any_size(size: tuple[int, int]) -> None:
    """White letters end inside the dark plate, which ends inside the photo."""
    image = grey_photo(*size)
    lines = ["arm1: ok, 9/9 markers, 0.01 px, outline 0.2 px", "focal length estimated: 600 px +- 2.5 %"]
    write_lines(image, lines, np.zeros(size, bool))
    rows, columns = np.nonzero((image != 100).any(axis=2))
    share = (rows.max() + 1) * (columns.max() + 1) / (size[0] * size[1])
    assert share <= 1
    if size[1] >= 192:
        white = np.nonzero((image > 200).all(axis=2))
        assert white[1].max() < columns.max() - 1
        assert white[0].max() < rows.max()
        assert share < 0.4
