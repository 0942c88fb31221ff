"""Lathe surfaces: their volume, hull and water level."""

from __future__ import annotations

import math

import numpy as np
import pytest

from yamsim_cli.core.geometry.closed_surface import (
    count_open_edges,
    depth_in_hull,
    spread_points,
    uniform_mass_properties,
)
from yamsim_cli.core.geometry.height_map import compute_height_map, water_level
from yamsim_cli.core.geometry.loft import (
    loft,
    loft_closed,
    revolve,
    rounded_rectangle,
    shell_profile,
    translate_surface,
    tube,
)


def block(x: float, y: float, z: float) -> tuple[np.ndarray, np.ndarray]:
    return loft([rounded_rectangle(x / 2, y / 2, 0.0, 0.0), rounded_rectangle(x / 2, y / 2, 0.0, z)])


def test_a_block_has_the_volume_centre_and_inertia_of_a_block() -> None:
    surface = translate_surface(block(0.2, 0.1, 0.3), (0.5, -0.2, 0.1))
    found = uniform_mass_properties(*surface)
    assert count_open_edges(surface[1]) == 0
    assert found.volume == pytest.approx(0.006)
    assert found.centre == pytest.approx([0.5, -0.2, 0.25])
    expected = np.diag([0.1**2 + 0.3**2, 0.2**2 + 0.3**2, 0.2**2 + 0.1**2]) * 0.006 / 12
    assert found.inertia == pytest.approx(expected, abs=1e-12)


def test_a_shell_is_closed_and_as_thick_as_it_was_told() -> None:
    inside = np.array([[0, 0.004], [0.04, 0.004], [0.042, 0.006], [0.042, 0.1]])
    surface = revolve(shell_profile(inside, 0.004), 96)
    assert count_open_edges(surface[1]) == 0
    wall, floor = math.pi * (0.046**2 - 0.042**2) * 0.1, math.pi * 0.042**2 * 0.004
    assert uniform_mass_properties(*surface).volume == pytest.approx(wall + floor, rel=0.03)


def test_a_tube_and_a_ring_are_closed() -> None:
    rod = tube([[0, 0, 0], [0.1, 0, 0], [0.2, 0.05, 0]], 0.01, 0.004, (0, 1, 0))
    angle = 2 * np.pi * np.arange(12) / 12
    loops = [np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(12, z)])
             for r, z in ((0.02, 0.0), (0.03, 0.0), (0.03, 0.05), (0.02, 0.05))]  # fmt: skip
    hoop = loft_closed(loops)
    for surface in (rod, hoop):
        assert count_open_edges(surface[1]) == 0
        assert uniform_mass_properties(*surface).volume > 0


@pytest.mark.parametrize("missing", [1, 5])
def test_holes_are_counted(missing: int) -> None:
    _, faces = block(0.1, 0.1, 0.1)
    assert count_open_edges(faces[missing:]) >= 3


def test_depth_in_a_hull() -> None:
    vertices, _ = block(0.2, 0.2, 0.2)
    inside = depth_in_hull(np.array([[0, 0, 0.1], [0, 0, 0.15], [0, 0, 0.25]]), vertices)
    assert inside == pytest.approx([0.1, 0.05, -0.05])


def test_spread_points_are_even() -> None:
    points = spread_points(np.zeros(3), np.ones(3), 4000)
    counts = np.histogramdd(points, bins=(4, 4, 4), range=[(0, 1)] * 3)[0]
    assert counts.min() > 50
    assert counts.max() < 75


def test_water_stands_in_a_cup_up_to_its_rim_and_runs_through_a_hoop() -> None:
    inside = np.array([[0, 0.004], [0.05, 0.004], [0.05, 0.1]])
    grid = compute_height_map(revolve(shell_profile(inside, 0.004), 64), 48)
    depth = np.where(np.isfinite(grid.top), water_level(grid.top) - np.where(np.isfinite(grid.top), grid.top, 0), 0)
    assert depth.max() == pytest.approx(0.0965, abs=0.003)
    assert depth.sum() * grid.cell_size**2 == pytest.approx(math.pi * 0.05**2 * 0.096, rel=0.06)
    angle = 2 * np.pi * np.arange(48) / 48
    hoop = loft_closed([np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(48, z)])
                 for r, z in ((0.04, 0.0), (0.05, 0.0), (0.05, 0.05), (0.04, 0.05))])  # fmt: skip
    through = compute_height_map(hoop, 48)
    level = water_level(through.top)
    there = np.isfinite(through.top)
    assert level[there] == pytest.approx(through.top[there], abs=1e-9)
