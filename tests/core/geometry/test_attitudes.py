"""Faces on which a body stands stably."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.geometry.stable_poses import placeable_poses, stable_poses


def _box(*size: float) -> Array:
    return np.array(list(itertools.product(*((-length / 2, length / 2) for length in size))))


def _cylinder(radius: float, height: float) -> Array:
    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    return np.concatenate([np.column_stack([x, y, np.full(48, z)]) for z in (-height / 2, height / 2)])


def test_a_cube_has_six_faces_of_one_kind() -> None:
    found = placeable_poses(_box(0.045, 0.045, 0.045), np.zeros(3))
    down = np.array([one.down for one in found])
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    assert len(found) == 6 and np.allclose((axes @ down.T).max(axis=1), 1, atol=1e-3)
    assert [one.height for one in found] == pytest.approx([0.0225] * 6, abs=1e-4)
    for one in found:
        assert one.rotation @ one.down == pytest.approx([0, 0, -1], abs=1e-6)
    assert len(stable_poses(_box(0.045, 0.045, 0.045), np.zeros(3))) == 1


def test_what_tips_easily_is_no_steady_face() -> None:
    slab = placeable_poses(_box(0.1, 0.1, 0.01), np.zeros(3))
    assert {tuple(np.round(one.down).astype(int)) for one in slab} == {(0, 0, 1), (0, 0, -1)}


def test_a_can_stands_on_its_ends_and_rolls_on_its_side() -> None:
    found = placeable_poses(_cylinder(0.033, 0.1), np.zeros(3))
    assert sorted(float(np.round(one.down[2])) for one in found) == [-1, 1]
