"""Cloth that two hands slide and turn, flat."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.programs import FOLD, bench_at_start, session_of
from yamsim_cli.core.episode.simulator import SimulatorCache
from yamsim_cli.core.expert.skills.cloth.cloth_motions import predict_cloth_points
from yamsim_cli.core.geometry.cloth_flattening import height_range
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.kitchen_skills.slide_grasps import SLIDE_SPEED, find_slide_grasps


def _turned(points: Array) -> float:
    """Rotation of a sheet's rows from x, degrees."""
    along = points[:, -1] - points[:, 0]
    return float(np.degrees(np.arctan2(along[:, 1].mean(), along[:, 0].mean())))


@pytest.mark.slow
def test_two_hands_slide_cloth_to_where_it_is_wanted_and_nowhere_else(tmp_path: Path) -> None:
    with SimulatorCache(session_of(tmp_path, FOLD)) as simulators:
        bench = bench_at_start(simulators)
        points = bench.world.cloth_points("napkin")
        turned = _turned(points)
        assert 10 <= turned <= 20

        def wanted(points: Array) -> bool:
            return abs(_turned(points)) < 4

        grasps = find_slide_grasps(bench, "napkin", [np.radians(-turned)], wanted)
        assert grasps is not None and len(grasps) == 2 and all(grasp.placement.single_layer for grasp in grasps)
        after = predict_cloth_points(bench, "napkin", grasps, 0.0, SLIDE_SPEED)
        assert wanted(after) and height_range(after) < 0.01
        # It comes nearer to the arms by 10 cm: a pull moves it straight.
        assert np.ptp(after[..., 0]) < 0.22
        assert after[..., 0].mean() == pytest.approx(points[..., 0].mean() - 0.1, abs=0.02)
        assert find_slide_grasps(bench, "napkin", [0.0], lambda points: False) is None
