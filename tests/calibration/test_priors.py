"""What the fit assumes before it sees the pictures."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from yamsim_cli.calibration.calibrate_run import offset_refusal
from yamsim_cli.calibration.station_fit import DELAY, FitPriors, Layout, StationProblem, start_state
from yamsim_cli.calibration.uncertainty import _with_joint2_error
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.geometry.se3 import pose, rotation_z


def test_the_priors_hold_the_rig_and_not_the_start_of_the_fit(station: RigConfig) -> None:
    view = cast(
        Any, SimpleNamespace(renderer=SimpleNamespace(arm_of_body=np.zeros(3, np.int64)), kinds=np.zeros((2, 3)))
    )
    problem = StationProblem(station, [view], [], FitPriors((0.01,)))
    state = start_state(station, [pose((0.0, 0.0, 1.0))], [0.0], 3)
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


def test_an_error_of_the_second_joint_widens_what_follows_it() -> None:
    layout = Layout(1, 0, (6,), 0)
    fit = cast(Any, SimpleNamespace(layout=layout))
    joint, tilt = layout.offsets(0).start + 1, layout.camera(0).start
    covariance = np.diag(np.full(layout.size, 1e-6))
    covariance[joint, tilt] = covariance[tilt, joint] = 0.5e-6
    wider = _with_joint2_error(covariance, fit, 0.004)
    assert wider[joint, joint] == pytest.approx(1e-6 + 0.004**2)
    assert wider[tilt, tilt] == pytest.approx(1e-6 + 0.002**2)
    assert wider[joint + 1, joint + 1] == pytest.approx(1e-6)


def test_implausible_joint_offsets_are_refused(station: RigConfig) -> None:
    state = start_state(station, [pose((0.0, 0.0, 1.0))], [0.0], 3)
    assert offset_refusal(station, state) is None
    state.offsets[0][4] = np.radians(-4.0)
    refusal = offset_refusal(station, state)
    assert refusal is not None and f"joint 5 of {station.arms[0].name} would have an offset of -4.0" in refusal
