"""What the fit assumes before it sees the pictures."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from yamsim_cli.calibration.calibrate_run import offset_refusal
from yamsim_cli.calibration.station_fit import DELAY, FitPriors, StationProblem, start_state
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.geometry.se3 import pose, rotation_z


def test_the_priors_hold_the_rig_and_not_the_start_of_the_fit(station: RigConfig) -> None:
    view = cast(Any, SimpleNamespace(renderer=SimpleNamespace(arm_of_body=np.zeros(3, np.int64))))
    problem = StationProblem(station, [view], [], FitPriors((0.01,)))
    state = start_state(station, [pose((0.0, 0.0, 1.0))], [0.0])
    assert not problem.prior_deviation(state).any()
    other = 1 - station.recording_order[0]
    bases = list(state.T_arm_in_base)
    bases[other] = pose((0.0, 0.0, 0.02)) @ bases[other] @ pose(rotation=rotation_z(0.01))
    offsets = tuple(np.full_like(one, 0.03) for one in state.offsets)
    moved = problem.prior_deviation(replace(state, delays=(0.05,), offsets=offsets, T_arm_in_base=tuple(bases)))
    assert moved[problem.layout.camera(0)][DELAY] == 0.05
    np.testing.assert_allclose(moved[problem.layout.offsets(other)], 0.03)
    place = problem.layout.base(other)
    np.testing.assert_allclose(moved[place], [0, 0, 0.01, 0, 0, 0.02], atol=1e-9)


def test_implausible_joint_offsets_are_refused(station: RigConfig) -> None:
    state = start_state(station, [pose((0.0, 0.0, 1.0))], [0.0])
    assert offset_refusal(station, state) is None
    state.offsets[0][4] = np.radians(-4.0)
    refusal = offset_refusal(station, state)
    assert refusal is not None and f"joint 5 of {station.arms[0].name} would have an offset of -4.0" in refusal
