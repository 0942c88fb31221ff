"""Settings of a simulated station, and the format of its states, commands and pictures."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from .api import API_SESSION_OPENER
from .session_opener import SessionOpener

if TYPE_CHECKING:
    from .core.config.recording import RecordConfig

# Name in `SessionOpener` -> name in `StationSettings`, where they differ.
_FIELD_OF_SETTING = {"camera": "cameras"}


@dataclass(frozen=True)
class StationSettings:
    """Settings of a station. They have the meaning of the flags of `yamsim record`; None takes the config's value.

    Attributes:
        action: "drives" for drive commands (rad, m) and then the weld of each arm; "joints" for joints (rad) and
            relative gripper openings, without welds.
        fps: frame rate, Hz.
        size: (width, height) of pictures, px, or a text such as `640x480`.
        cameras: names in order; by default the scene and wrist cameras, or the cameras that the rig defines.
        config: a name from `configs/record/`, or a file.
        spelling: format of the names of settings in error messages, such as "--env.{}".
    """

    task: str | None = None
    rig: str | None = None
    arm: str | None = None
    grasp: str | None = None
    action: str | None = None
    fps: float | None = None
    size: tuple[int, int] | str | None = None
    quality: str | None = None
    cameras: tuple[str, ...] | None = None
    randomize: bool | None = None
    config: str = "default"
    spelling: str = "{}="

    @property
    def opener(self) -> SessionOpener:
        """The session opener, whose messages name settings by `spelling`."""
        return dataclasses.replace(
            API_SESSION_OPENER, setting_label=lambda name: self.spelling.format(_FIELD_OF_SETTING.get(name, name))
        )

    @property
    def given(self) -> dict[str, Any]:
        """Return the settings as keyword arguments of `SessionOpener.load_record_config`."""
        apart = ("config", "spelling")
        given = {one.name: getattr(self, one.name) for one in dataclasses.fields(self) if one.name not in apart}
        return given | {"camera": given.pop("cameras"), "wrist": True}


@dataclass(frozen=True)
class StationForm:
    """Names of the numbers in states and commands, and shapes of pictures. Known before the station is built.

    Attributes:
        state, action: names of the numbers.
        environment: names of the numbers of the object poses: position, two axes and joints of each object.
        cameras: camera -> (height, width, 3).
        fps: frame rate, Hz.
        prompt: trials of a task with several phrasings may use another one.
    """

    state: tuple[str, ...]
    action: tuple[str, ...]
    environment: tuple[str, ...]
    cameras: Mapping[str, tuple[int, int, int]]
    fps: float
    most_frames: int
    prompt: str

    @classmethod
    def from_settings(cls, settings: StationSettings) -> StationForm:
        """Return the form of a station with these settings, without building a scene."""
        opener = settings.opener
        return cls.of_config(opener.load_record_config(settings.config, opener.find_locations(), **settings.given))

    @classmethod
    def of_config(cls, config: RecordConfig) -> StationForm:
        """Return the form of a station with a record config."""
        from .core.dataset.environment_state import object_pose_keys, state_names
        from .core.dataset.row_format import RowFormat

        joints = {item.name: [link.name for link in item.links] for item in config.task.objects}
        rows, timing = RowFormat.from_config(config), config.task.timing
        width, height = config.image.size_px
        return cls(
            rows.drives,
            rows.action_names,
            state_names(tuple(object_pose_keys(config)), joints),
            dict.fromkeys(config.recorded_cameras, (height, width, 3)),
            round(1 / (timing.tick_seconds * timing.ticks_per_frame), 6),
            config.task.max_ticks // timing.ticks_per_frame,
            config.task.language_prompt,
        )
