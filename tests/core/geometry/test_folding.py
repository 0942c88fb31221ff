"""Folded sheets: overlapping points, and covered area."""

from __future__ import annotations

import numpy as np
import pytest

from yamsim_cli.core.geometry.cloth_folding import ClothFoldKind, fold_plans, outline_area, sheet_area


def _exactly(how: ClothFoldKind, side: int) -> np.ndarray:
    """A square sheet (side, side, 3), folded exactly."""
    u, v = np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side))
    match how:
        case "half":
            x, y = u, np.minimum(v, 1 - v)
        case "diagonal":
            x, y = np.minimum(u, v), np.maximum(u, v)
        case "thirds":
            # The first third is two cells of eight; the last one, of three, ends on its crease.
            x, y = u, np.where(v < 1 / 4, 1 / 2 - v, np.where(v > 5 / 8, 5 / 4 - v, v))
    return np.stack([x, y, np.zeros_like(x)], axis=-1)


@pytest.mark.parametrize(
    ("how", "covered", "least"), [("half", 1 / 2, 0.3), ("diagonal", 1 / 2, 0.3), ("thirds", 3 / 8, 0.1)]
)
def test_what_lies_on_each_other_does_and_covers_its_share(how: ClothFoldKind, covered: float, least: float) -> None:
    sheet, apart = _exactly(how, 9), []
    for way in fold_plans(how, 9, 9):
        places = [[sheet[layer[:, 0], layer[:, 1]] for layer in pair] for pair in way.layers]
        apart.append(max(float(np.abs(one - other).max()) for one, other in places))
        assert way.covered == pytest.approx(covered)
    assert min(apart) == pytest.approx(0, abs=1e-12)
    assert max(apart) > least
    assert sheet_area(sheet) == pytest.approx(1)
    assert outline_area(sheet[..., :2].reshape(-1, 2)) == pytest.approx(covered)


@pytest.mark.parametrize("how", ["half", "diagonal", "thirds"])
def test_what_is_moved_comes_to_lie_where_its_way_says(how: ClothFoldKind) -> None:
    sheet = _exactly(how, 9)
    apart = [
        max(float(np.abs(sheet[one] - sheet[other]).max()) for move in way.moves for one, other in move)
        for way in fold_plans(how, 9, 9)
    ]
    assert min(apart) == pytest.approx(0, abs=1e-12)


def test_a_fold_that_the_grid_does_not_allow_has_no_plan() -> None:
    assert not fold_plans("diagonal", 7, 9)
    assert not fold_plans("thirds", 7, 10)
    assert [way.moves[0][0] for way in fold_plans("thirds", 7, 9)] == [((0, 0), (0, 4)), ((0, 8), (0, 4))]
    assert [len(way.layers[0][0]) for way in fold_plans("half", 6, 9)] == [27, 27, 24, 24]
