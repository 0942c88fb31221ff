"""How a print bends and how its markers are misplaced, and that the uncertainty of its pose holds both."""

from __future__ import annotations

import numpy as np
import pytest

from tests.bench.print_shape import CHI_95, CHI_997, trial
from tests.damaged_photos import Damage, bowed, enlarged_print, twisted
from yamsim_cli.core.geometry.board import Board
from yamsim_cli.core.vision.fiducials.fitting.print_shape import placement_modes


def test_a_column_moves_its_own_markers_and_the_size_moves_all_edges() -> None:
    board = Board("wide", 0, 3, 2, "DICT_6X6_250", 0.03, 0.003)
    corners = board.corners()[..., :2]
    for k, marker in enumerate(corners):
        row, column = divmod(k, 3)
        by_x, by_y = placement_modes(board, marker)
        assert by_x[:, :5].tolist() == [[float(column == n) for n in range(3)] + [0.0, 0.0]] * 4
        assert by_y[:, :5].tolist() == [[0.0] * 3 + [float(row == n) for n in range(2)]] * 4
        assert np.column_stack([by_x[:, 5], by_y[:, 5]]) == pytest.approx(
            np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]])
        )


@pytest.mark.parametrize("seed", [24, 68, 79, 113])
def test_the_uncertainty_of_a_print_whose_markers_are_rounded_holds_its_pose(seed: int) -> None:
    """Without placement, these poses were outside; without the markers' size, they were 1 mm too far away."""
    found = trial(seed, enlarged_print)
    assert found.off < CHI_997
    assert found.mm < 0.5


@pytest.mark.parametrize("damage", [bowed, twisted])
@pytest.mark.parametrize("seed", [300, 301])
def test_the_uncertainty_of_a_bent_print_holds_its_pose(damage: Damage, seed: int) -> None:
    assert trial(seed, damage).off < CHI_95
