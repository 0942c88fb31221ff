"""Leader arms report a motion's commands in the frames of the maker's encoders."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.real.recordings.making import swinging, write_csv
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.errors import UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.recorded_motion import RecordedMotion
from yamsim_cli.real.motors.can_frames import CanFrame
from yamsim_cli.real.serve.leader_arms import LeaderArms, leader_channels, read_leader_motion
from yamsim_cli.real.serve.served_arms import ServedArms, serve_arms

RAD = 2 * math.pi / 4096  # per count
SIGNS = np.array([-1, -1, 1, 1, -1, -1])


class FakeBus:
    """Keeps what is sent, and delivers what is in `requests`."""

    readers: tuple[Any, ...] = ()

    def __init__(self) -> None:
        self.sent: list[CanFrame] = []
        self.requests: list[CanFrame] = []

    def receive(self, ready: set[Any]) -> list[CanFrame]:
        frames, self.requests = self.requests, []
        return frames

    def send(self, frame: CanFrame) -> None:
        self.sent.append(frame)

    def flush(self) -> None:
        pass


class Stage:
    """Leaders of the station, whose followers are driven by their joint controllers."""

    def __init__(self, served: ServedArms, motion: RecordedMotion) -> None:
        self.served, self.motion = served, motion
        self.buses = FakeBus(), FakeBus()
        self.leaders = LeaderArms(served, motion, self.buses)  # type: ignore[arg-type]

    def run(self, seconds: float) -> None:
        plant = self.served.motor_simulation
        for _ in range(round(seconds / plant.timestep)):
            for follower in self.served.followers:
                follower.command_motors()
            plant.step()
            self.leaders.handle(set())
            self.leaders.flush()

    def run_until_button(self, pressed: int) -> None:
        for _ in range(100):
            self.run(0.1)
            if self.last(0)[1] == self.last(1)[1] == pressed:
                return
        raise AssertionError("the button did not change in 10 s")

    def request(self, arm: int, *data: int) -> None:
        self.buses[arm].requests.append(CanFrame(0x50E, bytes(data)))

    def last(self, arm: int) -> tuple[np.ndarray, int]:
        """Reported angles (7,), rad, and buttons of the trigger's device."""
        frames = {frame.data[0]: frame for frame in self.buses[arm].sent}
        assert {frame.id for frame in frames.values()} == {0x50F}
        counts = [int.from_bytes(frames[k].data[1:3], "big", signed=True) for k in range(7)]
        return np.array(counts) * RAD, frames[6].data[5]

    def wanted(self, arm: int, row: int) -> np.ndarray:
        one = self.motion.arms[arm]
        assert one.commands is not None and one.commanded_openings is not None
        share = min(one.commanded_openings[row] / self.served.followers[arm].full_opening, 1.0)
        return np.append(SIGNS * one.commands[row], -0.67 * (1 - share))


@pytest.fixture
def stage(make_config: Callable[..., RecordConfig], station: RigConfig, locations: Locations) -> Stage:
    served = serve_arms(Session(make_config({("rig",): station.name}), locations), start="task")
    return Stage(served, swinging(station, 0.5))


@pytest.mark.slow
def test_they_hold_the_first_pose_until_all_followers_follow_and_then_perform(stage: Stage) -> None:
    left, right = stage.served.followers
    hold = [np.append(np.asarray(arm.commands)[0], 0.5) for arm in stage.motion.arms]
    left.command_joint_pos(hold[0])
    stage.run(1.5)
    np.testing.assert_allclose(stage.last(0)[0], stage.wanted(0, 0), atol=RAD)
    assert stage.last(0)[1] == stage.last(1)[1] == 0

    right.command_joint_pos(hold[1])
    stage.run_until_button(0b10)
    np.testing.assert_allclose(stage.last(1)[0], stage.wanted(1, 0), atol=RAD)
    stage.run(1.1)
    assert stage.last(0)[1] == 0
    # A second later the motion, and a second after its end the button again.
    stage.run_until_button(0b10)
    for arm in range(2):
        np.testing.assert_allclose(stage.last(arm)[0], stage.wanted(arm, -1), atol=RAD)
    stage.run(1.1)
    assert stage.last(1)[1] == 0


def test_encoders_obey_the_sdks_requests(stage: Stage) -> None:
    stage.run(0.1)
    assert 9 * 7 <= len(stage.buses[0].sent) <= 11 * 7
    stage.request(0, 0xFF, 0x01, 0)
    stage.request(1, 2, 0x00)
    stage.run(0.01)
    stage.buses[0].sent.clear()
    stage.run(0.1)
    assert not stage.buses[0].sent
    assert stage.last(1)[0][2] == 0 and stage.last(1)[0][1] != 0
    stage.request(0, 3, 0x02)
    stage.run(0.01)
    assert [frame.data[0] for frame in stage.buses[0].sent] == [3]
    stage.buses[0].sent.clear()
    stage.request(0, 0xFF, 0x01, 0x01, 0xF4)  # 500 Hz
    stage.run(0.102)
    assert 48 * 7 <= len(stage.buses[0].sent) <= 51 * 7


def test_the_leaders_channels_have_the_makers_names(stage: Stage) -> None:
    assert list(leader_channels(stage.served)) == [("left", "can_lead_l"), ("right", "can_lead_r")]


def test_a_dataset_of_several_episodes_is_refused(
    station: RigConfig, single: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    path = write_csv(tmp_path / "one.csv", swinging(station, 0.5), station)
    assert len(read_leader_motion(path, station, locations).arms) == 2
    from tests.export.station_datasets import motion_at, station_dataset

    two = station_dataset(tmp_path / "two", [motion_at(station, 3)] * 2, station, locations)
    with pytest.raises(UsageError, match=r"has 2 episodes; give one, such as .*/ep_000000"):
        read_leader_motion(two, station, locations)
