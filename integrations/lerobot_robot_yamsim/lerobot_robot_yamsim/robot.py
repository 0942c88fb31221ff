"""yamsim's simulated arms as a robot of LeRobot."""

from __future__ import annotations

import logging
import time
from typing import Any

import numpy as np
from lerobot.robots import Robot
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from numpy.typing import NDArray

from yamsim_cli.live_station import LiveStation

from .config import YamsimRobotConfig
from .phases import Phase, Phases, link_of

_log = logging.getLogger(__name__)


class YamsimRobot(Robot):
    """Simulated arms in real time. An observation has each joint and gripper, and each camera's picture.

    The next trial's scene is set up while `lerobot-record` waits for people to set up the next episode.

    Attributes:
        cameras: camera -> shape of its pictures (height, width, 3).
    """

    config_class = YamsimRobotConfig
    name = "yamsim"

    def __init__(self, config: YamsimRobotConfig) -> None:
        super().__init__(config)
        self.config = config
        self.cameras = dict(config.form.cameras)
        self._link = link_of(config.id)
        self._station: LiveStation | None = None
        self._plan: NDArray[np.float32] | None = None
        self._keys = self._link.keys = tuple(f"{name}.pos" for name in config.form.action)

    @property
    def observation_features(self) -> dict[str, Any]:
        """Name of a joint or gripper with `.pos` -> float, and camera -> shape of its pictures (height, width, 3)."""
        return {**dict.fromkeys(self._keys, float), **self.cameras}

    @property
    def action_features(self) -> dict[str, Any]:
        """Name of a joint or gripper with `.pos` -> float."""
        return dict.fromkeys(self._keys, float)

    @property
    def is_connected(self) -> bool:
        """Whether the simulation is built."""
        return self._station is not None

    def connect(self, calibrate: bool = True) -> None:
        """Build the simulation, and set up the first scene.

        Raises:
            DeviceAlreadyConnectedError: the robot is connected.
            ValueError: an expert is connected, and the duration of episodes is not known.
            yamsim_cli.YamsimError: the simulation cannot be built.
        """
        if self._station is not None:
            raise DeviceAlreadyConnectedError(f"{self} is already connected")
        config = self.config
        if self._link.expert and config.episode_time_s is None:
            raise ValueError(
                "--teleop.type=yamsim_expert has to know when an episode begins: give --dataset.episode_time_s and "
                "--dataset.reset_time_s on the command line, or --robot.episode_time_s and --robot.reset_time_s"
            )
        self._phases = Phases(config.episode_time_s, config.reset_time_s)
        self._station = LiveStation(config.settings, by_clock=config.by_clock)
        self._set_up(self._station, config.trial)

    @property
    def is_calibrated(self) -> bool:
        """Always."""
        return True

    def calibrate(self) -> None:
        """Do nothing."""

    def configure(self) -> None:
        """Do nothing."""

    def get_observation(self) -> dict[str, Any]:
        """Joints (rad), grippers (shares) and pictures of the same state.

        Raises:
            DeviceNotConnectedError: the robot is not connected.
        """
        station = self._connected_station()
        for phase in self._phases.begin_frame(time.perf_counter()):
            if phase is Phase.RESET:
                self._log_verdict(station)
                self._set_up(station, station.trial + 1)
            else:
                self._from = station.time
        if self._plan is not None:
            self._link.action = self._named(self._plan[self._step(station)])
        state, pictures = station.observe()
        return self._named(state) | pictures

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Command joints (rad) and grippers (shares).

        Raises:
            DeviceNotConnectedError: the robot is not connected.
            KeyError: a joint or gripper is missing.
            yamsim_cli.UsageError: a value is not finite.
        """
        station = self._connected_station()
        row = np.array([action[key] for key in self._keys], np.float32)
        station.command(row)
        station.advance()
        return self._named(row)

    def disconnect(self) -> None:
        """Stop the simulation.

        Raises:
            DeviceNotConnectedError: the robot is not connected.
        """
        station = self._connected_station()
        self._log_verdict(station)
        if station.lost_s:
            _log.warning("the simulation could not keep up, and paused for %.1f s in total", station.lost_s)
        station.close()
        self._station, self._link.action = None, None

    def _set_up(self, station: LiveStation, trial: int) -> None:
        seed = self.config.seed
        if self._link.expert:
            self._plan = station.begin_demonstrated(seed, trial)
        else:
            self._plan = None
            station.begin(seed, trial)
        self._from = 0.0
        _log.info("trial %d of seed %d is set up", station.trial, seed)

    def _step(self, station: LiveStation) -> int:
        """Index of the plan's present action: the first one until an episode begins, and the last one at the end."""
        assert self._plan is not None, "there is an expert"
        if self._phases.now is not Phase.EPISODE:
            return 0
        return min(round((station.time - self._from) * self.config.form.fps), len(self._plan) - 1)

    def _log_verdict(self, station: LiveStation) -> None:
        why = station.judge()
        _log.info("trial %d: %s", station.trial, f"failed: {why}" if why else "success")

    def _named(self, row: NDArray[np.float32]) -> dict[str, Any]:
        return dict(zip(self._keys, row.tolist(), strict=True))

    def _connected_station(self) -> LiveStation:
        if self._station is None:
            raise DeviceNotConnectedError(f"{self} is not connected")
        return self._station
