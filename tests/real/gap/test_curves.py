"""Phases, stops and delays of joints, at any sample rate."""

from __future__ import annotations

import numpy as np
import pytest

from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.real.gap.joint_curves import (
    PHASES,
    RESAMPLING_STEP,
    estimate_delay,
    find_command_stops,
    joints_at_rest,
    motion_phases,
    overshoot_after_stop,
    resample_and_smooth,
)


def trapezoid(times: Array) -> Array:
    """At rest for 1 s, 1 s of acceleration to 1 rad/s, 2 s at that speed, 0.5 s of braking, then at rest."""
    speed = np.interp(times, [0, 1, 2, 4, 4.5, 6], [0, 0, 1, 1, 0, 0])
    return np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(times))])[:, None]


@pytest.mark.parametrize("rate", [20, 100, 250])
def test_phases_are_those_of_the_motion(rate: int) -> None:
    times = np.arange(0, 6, 1 / rate)
    names = [str(PHASES[number]) for number in motion_phases(resample_and_smooth(times, trapezoid(times)), times)[:, 0]]
    found = {time: names[int(np.argmin(np.abs(times - time)))] for time in (0.5, 1.5, 3.0, 4.2, 5.5)}
    assert list(found.values()) == ["still", "accelerating", "cruising", "braking", "still"]


def test_noise_of_an_encoder_is_no_motion() -> None:
    times = np.arange(0, 6, 0.01)
    # rad, step of the manufacturer's CAN messages
    step = 25 / 65536
    names = motion_phases(resample_and_smooth(times, np.round(trapezoid(times) / step) * step), times)[:, 0]
    clean = motion_phases(resample_and_smooth(times, trapezoid(times)), times)[:, 0]
    assert (names == clean).mean() > 0.95


def test_a_joint_is_at_rest_some_time_after_it_became_still() -> None:
    times = np.arange(0, 6, 0.01)
    seen = resample_and_smooth(times, trapezoid(times))
    times, resting = seen.times, joints_at_rest(seen, seen)[:, 0]
    assert not resting[times < 0.29].any() and resting[(times > 0.35) & (times < 0.9)].all()
    assert not resting[(times > 1.1) & (times < 4.7)].any() and resting[times > 5.1].all()


def test_a_stop_is_found_with_its_direction() -> None:
    times = np.arange(0, 6, 0.01)
    for sign in (1.0, -1.0):
        commands = resample_and_smooth(times, sign * trapezoid(times), steps=True)
        (stop,) = find_command_stops(commands, 0)
        assert stop.direction == sign
        assert stop.begin * RESAMPLING_STEP == pytest.approx(4.45, abs=0.15)
        bump = 0.03 * np.exp(-(((commands.times - 4.7) / 0.05) ** 2))
        assert overshoot_after_stop(sign * (trapezoid(commands.times)[:, 0] + bump), stop) == pytest.approx(
            0.03, abs=2e-3
        )
        assert overshoot_after_stop(sign * trapezoid(commands.times)[:, 0], stop) == pytest.approx(0, abs=1e-6)


def test_a_pause_is_no_stop() -> None:
    times = np.arange(0, 3, 0.01)
    paused = np.interp(times, [0, 1, 1.5, 1.7, 2.2, 3], [0, 0, 0.5, 0.5, 1.0, 1.0])[:, None]
    assert len(list(find_command_stops(resample_and_smooth(times, paused, steps=True), 0))) == 1


@pytest.mark.parametrize("shift", [-0.0113, 0.0, 0.0037, 0.024, 0.31])
def test_a_delay_is_found_between_samples(shift: float) -> None:
    times = np.arange(0, 10, 0.01)

    def motion(at: Array) -> Array:
        return (0.3 * np.sin(3 * at) + 0.1 * np.sin(7.3 * at))[:, None]

    late = 0.7 * motion(times - shift) + 0.05
    assert estimate_delay(
        resample_and_smooth(times, motion(times)), resample_and_smooth(times, late), 0
    ) == pytest.approx(shift, abs=5e-4)


def test_motions_that_have_nothing_in_common_have_no_delay() -> None:
    times = np.arange(0, 10, 0.01)
    one, other = np.sin(3 * times)[:, None], np.sign(np.sin(11 * times + 1))[:, None]
    assert estimate_delay(resample_and_smooth(times, one), resample_and_smooth(times, other), 0) is None
    assert estimate_delay(resample_and_smooth(times, one), resample_and_smooth(times, 1e-3 * one), 0) is None


def test_commands_stay_until_the_next_one() -> None:
    times = np.array([0.0, 0.1, 0.2])
    held = resample_and_smooth(times, np.array([[0.0], [1.0], [2.0]]), steps=True)
    assert held.values[round(0.09 / RESAMPLING_STEP), 0] == 0 and held.values[round(0.1 / RESAMPLING_STEP), 0] == 1
