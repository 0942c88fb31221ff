"""Options of the gymnasium environments, and the session that they open. The import does not import MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from .api import API_SESSION_OPENER
from .core.config.session import Session

METADATA: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 31}


@dataclass(frozen=True)
class TaskOptions:
    """Options of the environments, as in `gym_env.PickPlaceEnv`."""

    render_mode: str | None = None
    observation: Literal["state", "images"] = "state"
    size: tuple[int, int] = (320, 240)
    max_ticks: int | None = None
    rig: str | None = None
    task: str | None = None
    arm: str | None = None
    config: str = "default"
    quality: str = "fast"
    end: Literal["success", "actor"] = "success"
    reach: str | None = None

    def __post_init__(self) -> None:
        if self.render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode {self.render_mode!r} is not valid: give None or 'rgb_array'")
        if self.observation not in ("state", "images"):
            raise ValueError(f"observation {self.observation!r} is not valid: give 'state' or 'images'")

    def open_session(self) -> Session:
        """Return the session of the task. OpenGL is set up only if something is rendered."""
        given: dict[str, Any] = {"rig": self.rig, "task": self.task, "arm": self.arm, "wrist": True}
        given |= {"size": self.size, "quality": self.quality}
        if self.observation == "images" or self.render_mode is not None:
            return API_SESSION_OPENER.open(self.config, parallel=False, **given)
        # Neither set up nor disable OpenGL: another environment of this process may render.
        where = API_SESSION_OPENER.find_locations()
        return Session(API_SESSION_OPENER.load_record_config(self.config, where, **given), where)
