"""Which points of a sheet are between a hand's pads."""

from __future__ import annotations

import numpy as np
import pytest

from yamsim_cli.core.geometry.cloth_contacts import mask_between_pads, nearest_point_per_layer

_DEEP = (-0.008, 0.015)

# A strip of two cells, 25 mm each, three points along and two across; the second cell is folded back over the first.
_STRIP = np.array(
    [(x, y, z) for y in (0.0, 0.025) for x, z in ((0.0, 0.0), (0.025, 0.0), (0.003, 0.005))]
)  # fmt: skip
_CORNERS = np.array([(0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4)])


def test_points_between_pads_are_near_along_x_and_y_and_deep_enough_along_z() -> None:
    points = np.array([(0.0, 0.0, 0.0), (0.006, -0.006, 0.01), (0.009, 0.0, 0.0), (0.0, 0.0, 0.02), (0.0, 0.0, -0.01)])
    assert np.flatnonzero(mask_between_pads(points, 0.0072, _DEEP)).tolist() == [0, 1]


def test_of_every_layer_that_goes_through_the_nearest_point_is_held() -> None:
    # The pads close 8 mm from the end of the lower layer: its points are too far for pads of 7 mm, but the layer is
    # there.
    pinch = np.array([0.008, 0.005, 0.0])
    seen = _STRIP - pinch
    assert not mask_between_pads(seen, 0.0072, _DEEP)[[0]].any()
    middle = np.zeros((1, 2))
    assert nearest_point_per_layer(seen, _CORNERS, middle, _DEEP).tolist() == [0, 2]


@pytest.mark.parametrize("away", [(0.0, 0.0, 0.03), (0.0, 0.0, -0.02), (0.05, 0.0, 0.0), (0.0, -0.03, 0.0)])
def test_layers_beside_over_and_under_the_pads_are_not_held(away: tuple[float, float, float]) -> None:
    seen = _STRIP - [0.008, 0.005, 0.0] + away
    assert not len(nearest_point_per_layer(seen, _CORNERS, np.zeros((1, 2)), _DEEP))


def test_a_layer_is_held_that_only_one_side_of_the_pads_meets() -> None:
    # The lower layer starts at x = 0, the upper one at 3 mm: a line at 1.5 mm crosses the lower one alone, and a line
    # at the pads' end, 7 mm farther, crosses both.
    seen = _STRIP - [0.0015, 0.005, 0.0]
    assert nearest_point_per_layer(seen, _CORNERS, np.array([(0.0, 0.0)]), _DEEP).tolist() == [0]
    assert nearest_point_per_layer(seen, _CORNERS, np.array([(0.0, 0.0), (0.007, 0.0)]), _DEEP).tolist() == [0, 2]


def test_one_point_of_a_layer_is_held_and_not_a_second_one_that_would_keep_it_from_turning() -> None:
    # At 11 mm, the middle of the pads is nearer to the layer's end, and an end of the pads to its next point.
    lower = _CORNERS[:2]
    seen = _STRIP - [0.011, 0.005, 0.0]
    assert nearest_point_per_layer(seen, lower, np.array([(0.007, 0.0)]), _DEEP).tolist() == [1]
    assert nearest_point_per_layer(seen, lower, np.array([(0.0, 0.0), (0.007, 0.0)]), _DEEP).tolist() == [0]
