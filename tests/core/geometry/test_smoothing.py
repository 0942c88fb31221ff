"""Distance of a sheet from flat, and pulls that flatten it."""

from __future__ import annotations

import numpy as np
import pytest

from yamsim_cli.core.geometry.cloth_flattening import (
    candidate_pulls,
    fit_flat_places,
    max_displacement,
    sheet_unevenness,
)
from yamsim_cli.core.geometry.se3 import Array, rotation_z

_THICK, _SPACING = 0.005, 0.025


def _rest() -> Array:
    across, along = np.meshgrid(np.linspace(-0.1, 0.1, 9), np.linspace(-0.1, 0.1, 9))
    return np.column_stack([across.ravel(), along.ravel(), np.zeros(81)])


def _placed(points: Array) -> Array:
    """Rotate and move a sheet on a table."""
    placed: Array = (points @ rotation_z(0.4).T + [0.4, 0.05, _THICK / 2]).reshape(9, 9, 3)
    return placed


def _folded(over: Array) -> Array:
    """A sheet whose corner is folded over a diagonal crease."""
    points = over.copy()
    beyond = points[:, 0] + points[:, 1] - 0.1
    moved = beyond > 1e-9
    points[moved, :2] -= beyond[moved, None]
    points[moved, 2] = _THICK
    return points


def test_a_flat_sheet_is_even_whichever_side_is_up() -> None:
    for side in (1.0, -1.0):
        points = _placed(_rest() * [1.0, side, 1.0])
        assert sheet_unevenness(points, _rest(), _THICK) == pytest.approx(0.0, abs=1e-9)
        assert np.allclose(fit_flat_places(points, _rest(), _THICK), points[..., :2])
        assert not any(pull.arch_ratio for pull in candidate_pulls(points, _rest(), _THICK, _SPACING))


def test_a_folded_corner_is_brought_to_where_it_belongs() -> None:
    flat, points = _placed(_rest()), _placed(_folded(_rest()))
    # The corner's displacement is twice its distance from the crease.
    assert max_displacement(points, _rest(), _THICK) == pytest.approx(0.1 * np.sqrt(2), abs=2e-3)
    assert sheet_unevenness(points, _rest(), _THICK) > 0.02
    unfolding = [
        pull
        for pull in candidate_pulls(points, _rest(), _THICK, _SPACING)
        if pull.points == ((8, 8),) and pull.arch_ratio
    ]
    assert len(unfolding) == 1
    assert np.allclose(unfolding[0].targets[0], flat[8, 8, :2], atol=2e-3)


def test_what_lies_under_another_layer_or_stands_up_is_not_taken() -> None:
    under = _folded(_rest())
    # The same from below: the corner lifts the rest.
    under[:, 2] = np.where(under[:, 2] > 0, 0.0, _THICK)
    taken = {point for pull in candidate_pulls(_placed(under), _rest(), _THICK, _SPACING) for point in pull.points}
    assert taken and (8, 8) not in taken
    standing = _rest()
    standing[:9, 2] = 0.04
    taken = {point for pull in candidate_pulls(_placed(standing), _rest(), _THICK, _SPACING) for point in pull.points}
    assert taken and not any(row == 0 for row, _ in taken)


def test_bold_pulls_go_farther() -> None:
    ridge = _rest()
    # A ridge along the middle.
    ridge[ridge[:, 0] == 0.0, 2] = 0.012
    points = _placed(ridge)
    ways = [
        max(
            float(np.linalg.norm(to - points[point][:2]))
            for pull in candidate_pulls(points, _rest(), _THICK, _SPACING, bold)
            if not pull.arch_ratio
            for point, to in zip(pull.points, pull.targets, strict=True)
        )
        for bold in (1.0, 3.0)
    ]
    assert 0.02 < ways[0] < 0.03 and ways[1] == pytest.approx(3 * ways[0])


def test_two_corners_are_drawn_apart_by_a_twentieth_more_than_the_sheet_is_long() -> None:
    points = _placed(_rest() * [0.9, 0.97, 1.0])
    pairs = [
        pull
        for pull in candidate_pulls(points, _rest(), _THICK, _SPACING, 3.0)
        if len(pull.points) == 2 and not pull.arch_ratio
    ]
    assert len(pairs) == 6
    for pull in pairs:
        one, other = (_rest().reshape(9, 9, 3)[point] for point in pull.points)
        assert np.linalg.norm(pull.targets[0] - pull.targets[1]) <= 1.05 * np.linalg.norm(one - other) + 1e-9
