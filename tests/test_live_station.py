"""A simulated station in real time."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest

from yamsim_cli.live_station import LiveStation
from yamsim_cli.station import Station, StationSettings

pytestmark = pytest.mark.render
SETTINGS = StationSettings(
    rig="single_linear", grasp="contact", action="joints", fps=30, size=(32, 24), cameras=("scene_camera",)
)


def wait_for(true: Callable[[], bool], seconds: float = 20) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_time_passes_by_the_clock_once_a_trial_has_begun() -> None:
    with LiveStation(SETTINGS) as station:
        begun = time.monotonic()
        assert station.begin(seed=3, trial=1) == 1
        row, pictures = station.observe()
        assert pictures["scene_camera"].shape == (24, 32, 3)
        row[0] += 0.2
        station.command(row)
        wait_for(lambda: station.time > 1)
        # It may be slower than the clock on a busy machine, but never faster.
        assert station.time <= time.monotonic() - begun + 1 / 30
        assert station.observe()[0][0] == pytest.approx(row[0], abs=0.05)


def test_time_passes_with_frames_where_it_does_not_go_by_the_clock() -> None:
    with LiveStation(SETTINGS, by_clock=False) as station, Station(SETTINGS, pictures=False) as alone:
        rows = station.begin_demonstrated(seed=3)
        alone.begin_demonstrated(seed=3)
        time.sleep(0.1)
        assert station.time == 0
        for row in rows[:5]:
            for one in (station, alone):
                one.command(row)
                one.advance()
        assert station.time == pytest.approx(5 / 30)
        np.testing.assert_array_equal(station.observe()[0], alone.state())


def test_what_stops_the_simulation_is_told_to_whoever_observes(monkeypatch: pytest.MonkeyPatch) -> None:
    def breaks(self: Station) -> None:
        raise RuntimeError("it broke")

    with LiveStation(SETTINGS) as station:
        monkeypatch.setattr(Station, "tick", breaks)
        station.begin()

        def told() -> bool:
            try:
                station.observe()
            except RuntimeError as error:
                return str(error) == "it broke"
            return False

        wait_for(told)
