"""Where hands take cloth."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.programs import FOLD, bench_at_start, session_of
from yamsim_cli.core.episode.simulator import SimulatorCache
from yamsim_cli.core.expert.skills.cloth.point_grasps import PointPlacement, reachable_grasps, target_at_place


def test_a_hand_does_not_come_down_where_cloth_stands_up_beside_its_fingers(tmp_path: Path) -> None:
    with SimulatorCache(session_of(tmp_path, FOLD)) as simulators:
        bench = bench_at_start(simulators)
        flat = bench.world.cloth_points("napkin")
        place, around = flat[4, 8], ([3, 3, 4, 5, 5], [8, 7, 7, 7, 8])
        alone, all_of_it = (
            PointPlacement((4, 8), target_at_place(place), single_layer=alone) for alone in (True, False)
        )
        assert reachable_grasps(bench, "napkin", [alone], flat) is not None
        # The next points are nearer, and 1 and then 4 cm higher.
        standing = flat.copy()
        standing[around] += 0.3 * (place - flat[around]) + [0.0, 0.0, 0.01]
        assert reachable_grasps(bench, "napkin", [alone], standing) is not None
        standing[around] += [0.0, 0.0, 0.03]
        assert reachable_grasps(bench, "napkin", [alone], standing) is None
        # A fold includes all layers there.
        assert reachable_grasps(bench, "napkin", [all_of_it], standing) is not None
        assert np.array_equal(bench.world.cloth_points("napkin"), flat)
