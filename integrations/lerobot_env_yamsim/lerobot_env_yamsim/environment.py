"""A yamsim task as a gymnasium environment with LeRobot's observations."""

from __future__ import annotations

import logging
from fractions import Fraction
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from yamsim_cli import UsageError, YamsimError
from yamsim_cli.station import Station, StationForm, StationSettings

# LeRobot's keys of an observation.
STATE, PICTURES, ENVIRONMENT = "agent_pos", "pixels", "environment_state"

Observation = dict[str, Any]

_log = logging.getLogger(__name__)


class Rate(float):
    """A frame rate with a numerator and a denominator: LeRobot hands rates to JSON, and to PyAV, which needs both."""

    @property
    def numerator(self) -> int:
        """Of the nearest fraction with a small denominator."""
        return self._fraction.numerator

    @property
    def denominator(self) -> int:
        """Of the same fraction."""
        return self._fraction.denominator

    @property
    def _fraction(self) -> Fraction:
        return Fraction(self).limit_denominator(10_000)


def rate_of(fps: float) -> int | Rate:
    """A rate as an integer if it is whole."""
    return int(fps) if fps == int(fps) else Rate(fps)


def read_settings(settings: StationSettings) -> StationForm:
    """The form of a station with these settings.

    Raises:
        ValueError: a setting is not valid.
    """
    try:
        return StationForm.from_settings(settings)
    except YamsimError as error:
        raise ValueError(str(error)) from None


class YamsimEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Trials of one task; a step is a frame. The simulation is built when the first trial begins.

    An observation has `agent_pos`, a row of joints and grippers; `pixels`, camera -> picture (height, width, 3); and
    `environment_state`, the poses of things, if requested. The reward is 1 on success, which ends the trial, else 0;
    `info` has `is_success`. `reset(seed=S)` begins trial S, and `reset()` the next trial. An action that is not a
    finite number for each drive fails the trial.

    Attributes:
        task: its name.
        task_description: the task in words; of the trial, once there is one.

    Args:
        settings: of the station.
        pictures: whether observations have pictures.
        environment_state: whether observations have the poses of things.
        trials_of: seed of the trials.
        max_frames: limit of a trial's frames.
    """

    def __init__(
        self,
        settings: StationSettings,
        *,
        pictures: bool = True,
        environment_state: bool = False,
        trials_of: int = 0,
        max_frames: int | None = None,
    ) -> None:
        form = read_settings(settings)
        self._settings, self._form, self._seed = settings, form, trials_of
        self._has_pictures = pictures
        self._has_environment = environment_state
        self._station: Station | None = None
        self._pictures: dict[str, Any] = {}
        self._frames = 0
        # LeRobot reads this attribute.
        self._max_episode_steps = max_frames or form.most_frames
        self.task, self.task_description = settings.task, form.prompt
        self.render_mode = "rgb_array"
        self.metadata = {"render_modes": ["rgb_array"], "render_fps": rate_of(form.fps)}
        self.action_space: spaces.Space[Any] = _numbers(form.action)
        parts: dict[str, spaces.Space[Any]] = {STATE: _numbers(form.state)}
        if environment_state:
            parts[ENVIRONMENT] = _numbers(form.environment)
        if pictures:
            shown: dict[str, spaces.Space[Any]] = {
                camera: spaces.Box(0, 255, shape, np.uint8) for camera, shape in form.cameras.items()
            }
            parts[PICTURES] = spaces.Dict(shown)
        self.observation_space = spaces.Dict(parts)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin the trial of a seed, or the next one."""
        super().reset(seed=seed)
        if self._station is None:
            self._station = Station(self._settings)
            self._station.begin(self._seed, seed or 0)
        else:
            self._station.begin(self._seed, self._station.trial + 1 if seed is None else seed)
        self._frames, self.task_description = 0, self._station.prompt
        return self._observe(self._station), self._info(self._station, False)

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Let an action act for a frame."""
        station = self._station
        assert station is not None, "reset comes first"
        self._frames += 1
        success = failed = False
        try:
            station.command(action)
            success = station.advance()
        except UsageError as error:
            _log.warning("trial %d is lost: %s", station.trial, error)
            failed = True
        over = self._frames >= self._max_episode_steps
        return (
            self._observe(station),
            float(success),
            success or failed,
            over and not success,
            self._info(station, success),
        )

    def render(self) -> NDArray[np.uint8]:
        """The first camera's picture (height, width, 3) of the state that was observed last."""
        station = self._station
        assert station is not None, "reset comes first"
        first = next(iter(self._form.cameras))
        if first not in self._pictures:
            self._pictures |= station.pictures([first])
        picture: NDArray[np.uint8] = self._pictures[first]
        return picture

    def close(self) -> None:
        """Free the renderers."""
        if self._station is not None:
            self._station.close()
            self._station = None

    def _observe(self, station: Station) -> Observation:
        self._pictures = station.pictures() if self._has_pictures else {}
        seen: Observation = {STATE: station.state()}
        if self._has_environment:
            seen[ENVIRONMENT] = station.environment()
        return seen | {PICTURES: dict(self._pictures)} if self._has_pictures else seen

    def _info(self, station: Station, success: bool) -> dict[str, Any]:
        return {"is_success": success, "trial": station.trial}


def _numbers(names: tuple[str, ...]) -> spaces.Box:
    return spaces.Box(-np.inf, np.inf, (len(names),), np.float32)
