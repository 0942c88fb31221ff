"""Photos larger than the detector needs: the same boards in a fraction of the time."""

from __future__ import annotations

import numpy as np
import pytest

from tests.board_photos import facing, photograph
from yamsim_cli.core.geometry.board import Board
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.vision.fiducials import markers
from yamsim_cli.core.vision.fiducials.locate import locate
from yamsim_cli.core.vision.fiducials.markers import find_markers

pytestmark = pytest.mark.slow

LENGTH = 0.02923077
ONE = Board("one", 217, 3, 3, "DICT_6X6_250", LENGTH, LENGTH / 10)
TWO = Board("two", 226, 3, 3, "DICT_6X6_250", LENGTH, LENGTH / 10)
CAMERA = CameraModel.pinhole(7200, 5400, 6500.0)
# The first board's markers, 60 px, are about the smallest that the detector reads in a photo of this size.
PLACED = ((ONE, facing(-0.4, 0.3, 3.0, 0.3, 0.2)), (TWO, facing(0.2, 0.0, 1.2, 0.6, -0.2)))


@pytest.fixture(scope="module")
def photo() -> np.ndarray:
    return photograph(CAMERA, PLACED, blur=2.0)


def test_photos_show_the_same_markers_at_a_size_the_detector_needs(
    photo: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes = []
    stretched = markers._stretched

    def spy(grey: np.ndarray) -> np.ndarray:
        sizes.append(grey.shape)
        return stretched(grey)

    monkeypatch.setattr(markers, "_stretched", spy)
    found = {one.id: one.corners for one in find_markers(photo, ["DICT_6X6_250"])["DICT_6X6_250"]}
    monkeypatch.setattr(markers, "_SHRINK_TO", 10**6)
    whole = {one.id: one.corners for one in find_markers(photo, ["DICT_6X6_250"])["DICT_6X6_250"]}
    assert sizes == [(3072, 4096), (5400, 7200)]
    assert set(found) >= set(whole) >= set(TWO.ids)
    assert set(found) & set(ONE.ids)
    # Only where the search starts from; a pixel there is 1.8 px here.
    assert max(np.abs(found[number] - whole[number]).max() for number in whole) < 4.0


def test_a_board_in_a_photo_is_where_it_is(photo: np.ndarray) -> None:
    for sighting, (_, truth) in zip(locate(photo, CAMERA, [ONE, TWO])[0], PLACED, strict=True):
        T = sighting.T_board_in_cam
        assert T is not None, sighting.reason
        assert np.linalg.norm(T[:3, 3] - truth[:3, 3]) < 5e-4 * truth[2, 3]
