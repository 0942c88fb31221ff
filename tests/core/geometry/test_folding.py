"""Folded sheets: which points lie on each other, and how much they cover."""

from __future__ import annotations

import numpy as np
import pytest

from yamsim_cli.core.geometry.folding import COVERED, Fold, outline_area, sheet_area, ways_to_fold


def _exactly(how: Fold, side: int) -> np.ndarray:
    """A square sheet (side, side, 3), folded exactly."""
    u, v = np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side))
    match how:
        case "half":
            x, y = u, np.minimum(v, 1 - v)
        case "diagonal":
            x, y = np.minimum(u, v), np.maximum(u, v)
    return np.stack([x, y, np.zeros_like(x)], axis=-1)


@pytest.mark.parametrize("how", ["half", "diagonal"])
def test_what_lies_on_each_other_does_and_covers_its_share(how: Fold) -> None:
    sheet = _exactly(how, 7)
    apart = []
    for layers in ways_to_fold(how, 7, 7):
        places = [sheet[layer[:, 0], layer[:, 1]] for layer in layers]
        apart.append(max(float(np.abs(places[0] - other).max()) for other in places[1:]))
    assert min(apart) == pytest.approx(0, abs=1e-12)
    assert max(apart) > 0.3
    assert sheet_area(sheet) == pytest.approx(1)
    assert outline_area(sheet[..., :2].reshape(-1, 2)) == pytest.approx(COVERED)


def test_grids_that_cannot_be_folded_so() -> None:
    assert not ways_to_fold("diagonal", 7, 9)
    assert [len(layers[0]) for layers in ways_to_fold("half", 6, 9)] == [27, 24]
