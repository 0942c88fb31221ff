"""In small what `tests.bench.intervals` shows: stated intervals hold the truth, in photos by cameras nobody knows."""

from __future__ import annotations

import numpy as np
import pytest

from tests.bench.intervals import CASES, coverage, farthest, outcomes
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.resources import Locations


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    [
        pytest.param(CASES[0], id="ideal lens"),
        pytest.param(CASES[1], id="real lens"),
        pytest.param(CASES[4], id="camera given"),
    ],
)
def test_stated_intervals_hold_the_truth(locations: Locations, case) -> None:
    rig = load_config(RigConfig, "rigs", "russet", locations)
    found = [one for k in range(5) for one in outcomes(case, rig, seed=99, k=k)]
    good = [one for one in found if one.status == "ok"]
    assert len(good) >= 0.5 * len(found)
    assert farthest(found) < 4.0
    held = np.concatenate([np.array(offs) <= 1 for offs in coverage(found).values()])
    assert held.mean() > 0.85
    for one in found:
        assert one.status == "ok" or one.reason
