"""Logs that cannot tell how an arm moves are refused, by the joint and by what to record."""

from __future__ import annotations

import numpy as np
import pytest

from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.identify.identify import check_usable
from yamsim_cli.core.identify.plant import Log

NAMES = tuple(f"joint{k}" for k in range(1, 7))


def _swinging(seconds: float, rng: np.random.Generator) -> tuple[Array, Array]:
    times = np.arange(0, seconds, 0.01)
    pace = rng.uniform(0.2, 0.8, (3, 6))
    phase = rng.uniform(0, 6.3, (3, 6))
    waves = np.sin(2 * np.pi * pace[None] * times[:, None, None] + phase[None]).mean(axis=1)
    return times, 0.6 * waves


def _log(times: Array, joints: Array) -> Log:
    return Log("log.csv", times, joints, joints, None)


@pytest.mark.parametrize("seed", range(20))
def test_a_joint_that_is_badly_excited_is_named_with_what_to_record(seed: int) -> None:
    rng = np.random.default_rng(seed)
    times, joints = _swinging(30.0, rng)
    joint, way = int(rng.integers(6)), seed % 4
    noise = rng.normal(0, 2e-4, len(times))
    share = times / times[-1]
    joints[:, joint], said, remedy = (
        (noise, "hardly moves", "swinging to and fro by 0.5 rad"),
        (0.8 * share + noise, "never turns back", "swinging to and fro at least 4 times"),
        (0.4 * np.sin(np.pi * share) + noise, "turns back only once", "at least 4 times"),
        (0.12 * np.sin(8 * np.pi * share) + noise, "is always slow", "quicker swings"),
    )[way]

    with pytest.raises(DatasetError) as told:
        check_usable([_log(times, joints)], NAMES)

    assert f"joint{joint + 1} {said}" in str(told.value)
    assert remedy in str(told.value)
    assert "yamsim excite" in str(told.value)


def test_a_joint_that_only_others_shake_is_named() -> None:
    times, commands = _swinging(30.0, np.random.default_rng(0))
    joints = commands.copy()
    commands[:, 3] = 0.3 * times / times[-1]
    joints[:, 3] = commands[:, 3] + 0.06 * np.sin(20 * times)

    with pytest.raises(DatasetError, match="joint4 never turns back"):
        check_usable([Log("log.csv", times, commands, joints, None)], NAMES)


@pytest.mark.parametrize("seed", range(5))
def test_a_log_in_which_all_joints_swing_is_taken(seed: int) -> None:
    check_usable([_log(*_swinging(30.0, np.random.default_rng(seed)))], NAMES)


def test_what_one_log_lacks_another_may_show() -> None:
    times, joints = _swinging(30.0, np.random.default_rng(0))
    still = joints.copy()
    still[:, 2] = 0.0

    check_usable([_log(times, still), _log(times, joints)], NAMES)


def test_samples_without_joints_do_not_count() -> None:
    times, joints = _swinging(30.0, np.random.default_rng(0))
    measured = joints.copy()
    measured[1::2] = np.nan

    check_usable([Log("log.csv", times, joints, measured, None)], NAMES)


def test_a_short_log_is_refused() -> None:
    with pytest.raises(DatasetError, match=r"6\.0 s tell too little of the arm; record at least 10 s"):
        check_usable([_log(*_swinging(6.0, np.random.default_rng(0)))], NAMES)


def test_of_two_arms_the_side_is_told() -> None:
    times, joints = _swinging(30.0, np.random.default_rng(0))
    joints[:, 3] = 0.1

    with pytest.raises(DatasetError, match=r"left joint4 hardly moves"):
        check_usable([_log(times, joints)], NAMES, "left")
