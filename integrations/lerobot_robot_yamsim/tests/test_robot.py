"""The robot and its expert by themselves, where LeRobot is installed: `pytest integrations/lerobot_robot_yamsim`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lerobot.robots import make_robot_from_config
from lerobot.teleoperators import make_teleoperator_from_config
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from lerobot_robot_yamsim import YamsimExpert, YamsimExpertConfig, YamsimRobot, YamsimRobotConfig
from lerobot_robot_yamsim.phases import Phase, Phases

from yamsim_cli import UsageError

SMALL: dict[str, Any] = {"size": "32x24", "quality": "fast", "cameras": ["scene_camera"], "by_clock": False}
KEYS = [*(f"joint{k}.pos" for k in range(1, 7)), "gripper.pos"]


class Clock:
    """What the robot believes to be the time, s."""

    now = 0.0

    def perf_counter(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr("lerobot_robot_yamsim.robot.time", clock)
    return clock


@pytest.fixture
def robot(tmp_path: Path, clock: Clock) -> Iterator[YamsimRobot]:
    config = YamsimRobotConfig(
        id=tmp_path.name, calibration_dir=tmp_path, episode_time_s=8.0, reset_time_s=1.0, **SMALL
    )
    made = make_robot_from_config(config)
    assert isinstance(made, YamsimRobot)
    yield made
    if made.is_connected:
        made.disconnect()


@pytest.fixture
def expert(robot: YamsimRobot, tmp_path: Path) -> Iterator[YamsimExpert]:
    made = make_teleoperator_from_config(YamsimExpertConfig(robot_id=robot.id, calibration_dir=tmp_path))
    assert isinstance(made, YamsimExpert)
    made.connect()
    yield made
    made.disconnect()


def test_it_says_what_it_is_before_it_is_connected(robot: YamsimRobot) -> None:
    assert list(robot.action_features) == KEYS
    assert robot.observation_features == {**dict.fromkeys(KEYS, float), "scene_camera": (24, 32, 3)}
    for call in (robot.get_observation, robot.disconnect, lambda: robot.send_action(dict.fromkeys(KEYS, 0.0))):
        with pytest.raises(DeviceNotConnectedError, match="is not connected"):
            call()


def test_it_goes_where_it_is_told(robot: YamsimRobot) -> None:
    robot.connect()
    with pytest.raises(DeviceAlreadyConnectedError):
        robot.connect()
    seen = robot.get_observation()
    assert {key: np.shape(value) for key, value in seen.items() if key not in KEYS} == robot.cameras
    action = {key: seen[key] for key in KEYS} | {"joint1.pos": 0.3, "gripper.pos": 1.0}
    for _ in range(30):
        assert robot.send_action(action) == pytest.approx(action)
    seen = robot.get_observation()
    assert seen["joint1.pos"] == pytest.approx(0.3, abs=0.02) and seen["gripper.pos"] == pytest.approx(1, abs=0.05)
    with pytest.raises(UsageError, match="finite"):
        robot.send_action(action | {"joint2.pos": float("nan")})
    with pytest.raises(KeyError, match=r"joint6\.pos"):
        robot.send_action({key: 0.0 for key in KEYS if key != "joint6.pos"})


def test_an_expert_does_each_episode_and_waits_between_them(
    robot: YamsimRobot, expert: YamsimExpert, clock: Clock, caplog: pytest.LogCaptureFixture
) -> None:
    """As `lerobot-record` goes: 8 s of an episode, 1 s of setting up, twice."""
    caplog.set_level("INFO")
    robot.connect()
    assert list(expert.action_features) == KEYS
    waited: list[bool] = []
    for _ in range(2):
        for length, waits in ((8.0, False), (1.0, True)):
            began, still = clock.now, None
            while clock.now - began < length:
                robot.get_observation()
                action = expert.get_action()
                still = still or action
                waited.append(action == still)
                assert not waits or action == still
                robot.send_action(action)
                clock.now += 1 / 30 + 1e-4
            clock.now += 0.7  # It saves the episode.
    assert not all(waited)
    told = [record.message for record in caplog.records if record.message.startswith("trial")]
    assert told == [
        "trial 0 of seed 0 is set up",
        "trial 0: success",
        "trial 1 of seed 0 is set up",
        "trial 1: success",
        "trial 2 of seed 0 is set up",
    ]


def test_an_expert_has_to_know_when_episodes_begin(robot: YamsimRobot, expert: YamsimExpert) -> None:
    robot.config.episode_time_s = None
    with pytest.raises(ValueError, match=r"--dataset\.episode_time_s"):
        robot.connect()
    with pytest.raises(DeviceNotConnectedError, match=f"--robot.id={robot.id}"):
        expert.get_action()


def test_times_are_those_of_the_command_line(monkeypatch: pytest.MonkeyPatch) -> None:
    given = ["lerobot-record", "--dataset.episode_time_s=7.5", "--dataset.reset_time_s", "2"]
    monkeypatch.setattr(sys, "argv", given)
    config = YamsimRobotConfig(**SMALL)
    assert (config.episode_time_s, config.reset_time_s) == (7.5, 2.0)
    assert YamsimRobotConfig(**SMALL, episode_time_s=3.0).episode_time_s == 3.0
    monkeypatch.setattr(sys, "argv", given[:1])
    assert YamsimRobotConfig(**SMALL).episode_time_s is None


def test_settings_that_are_not_valid_are_told() -> None:
    with pytest.raises(ValueError, match=r"--robot\.rig: rig: unknown rig 'singl'"):
        YamsimRobotConfig(rig="singl")


def test_phases_follow_lerobots_loop() -> None:
    phases = Phases(2.0, 1.0)
    assert phases.begin_frame(10.0) == [Phase.EPISODE]
    assert phases.begin_frame(11.99) == []
    assert phases.begin_frame(12.01) == [Phase.RESET]
    assert phases.begin_frame(13.0) == []
    # It saved the episode, for however long.
    assert phases.begin_frame(20.0) == [Phase.EPISODE]
    assert phases.begin_frame(21.9) == []


def test_without_time_to_set_up_the_next_episode_begins_at_once() -> None:
    phases = Phases(2.0, 0.0)
    phases.begin_frame(0.0)
    assert phases.begin_frame(2.1) == [Phase.RESET, Phase.EPISODE]
    assert phases.begin_frame(4.0) == []


def test_nothing_is_set_up_again_where_nobody_says_how_long_an_episode_is() -> None:
    phases = Phases(None, None)
    assert [phases.begin_frame(float(now)) for now in (0, 1e6)] == [[Phase.EPISODE], []]
