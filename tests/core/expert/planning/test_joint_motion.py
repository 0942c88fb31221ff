"""Joint-space motions: smooth, within speeds, through their points; and searches around obstacles."""

from __future__ import annotations

import numpy as np
import pytest

from yamsim_cli.core.expert.planning.rrt_connect import plan_rrt_connect
from yamsim_cli.core.expert.planning.trajectory import is_collision_free, time_waypoints

TICK = 0.032
MOTORS = np.full(2, 5.0)


def test_starts_and_ends_at_rest_and_passes_its_points() -> None:
    points = [np.zeros(2), np.array([0.4, 0.1]), np.array([1.0, -0.2])]
    path = time_waypoints(points, MOTORS, TICK)
    assert path[0] == pytest.approx(points[0])
    assert path[-1] == pytest.approx(points[-1])
    assert min(np.abs(path - points[1]).max(axis=1)) < 1e-9
    velocities = np.diff(path, axis=0) / TICK
    assert np.abs(velocities[[0, -1]]).max() < 0.1
    assert np.abs(velocities).max() <= 2.3
    # Speed changes no more at a point than elsewhere.
    changes = np.abs(np.diff(velocities, axis=0)).max(axis=1)
    passing = int(np.abs(path - points[1]).max(axis=1).argmin())
    assert changes[passing - 2 : passing + 1].max() <= changes.max()
    assert changes.max() < 0.8


def test_a_slow_motor_takes_longer() -> None:
    points = [np.zeros(2), np.array([1.0, 0.0])]
    assert len(time_waypoints(points, np.full(2, 1.0), TICK)) > 3 * len(time_waypoints(points, np.full(2, 4.0), TICK))


def wall(joints: np.ndarray) -> str | None:
    """A wall at 0.5 with a gap above 0.8."""
    return "wall" if 0.45 < joints[0] < 0.55 and joints[1] < 0.8 else None


def test_a_wall_in_the_way_is_seen() -> None:
    assert not is_collision_free(time_waypoints([np.zeros(2), np.array([1.0, 0.0])], MOTORS, TICK), wall)
    assert is_collision_free(time_waypoints([np.zeros(2), np.array([0.4, 0.0])], MOTORS, TICK), wall)


def test_the_search_finds_the_gap_and_the_same_one_again() -> None:
    bounds = np.array([[-0.2, 1.2], [-0.2, 1.2]])
    ways = [
        plan_rrt_connect(np.zeros(2), np.array([1.0, 0.0]), bounds, wall, np.random.default_rng(3)) for _ in range(2)
    ]
    assert ways[0] is not None
    assert ways[1] is not None
    assert all((one == other).all() for one, other in zip(*ways, strict=True))
    for one, other in zip(ways[0][:-1], ways[0][1:], strict=True):
        assert not any(wall(one + (other - one) * share) for share in np.linspace(0, 1, 50))


def test_no_way_is_none() -> None:
    bounds = np.array([[-0.2, 1.2], [-0.2, 0.7]])
    assert plan_rrt_connect(np.zeros(2), np.array([1.0, 0.0]), bounds, wall, np.random.default_rng(3)) is None
    assert plan_rrt_connect(np.zeros(2), np.array([0.5, 0.0]), bounds, wall, np.random.default_rng(3)) is None
