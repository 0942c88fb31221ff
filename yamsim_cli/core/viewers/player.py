"""Plays recorded states in a loop, at their own pace."""

from __future__ import annotations

import mujoco

from ..geometry.se3 import Array
from .watched_state import WatchedState


class EpisodePlayer(WatchedState):
    """The state of a scene that is played and not simulated. Its methods may be called from any thread.

    Args:
        title: title of the page's tab.
        model: the scene.
        positions: MuJoCo's positions (frames, nq), a row for each frame.
        frame_period: simulated time from one frame to the next, s.
        speed: how fast time passes; 1 is real time.
    """

    def __init__(
        self, title: str, model: mujoco.MjModel, positions: Array, frame_period: float, speed: float = 1.0
    ) -> None:
        super().__init__()
        self.title = title
        self.model = model
        self.data = mujoco.MjData(model)
        self.frame_period = frame_period
        self._positions = positions
        self._speed = speed
        self._time = 0.0
        self._last: float | None = None
        self.reset()

    @property
    def frames(self) -> int:
        """How many frames there are."""
        return len(self._positions)

    @property
    def frame(self) -> int:
        """Number of the frame that is shown."""
        return min(int(self._time / self.frame_period), self.frames - 1)

    @property
    def time(self) -> float:
        """Simulated time since the first frame, s."""
        return self._time

    def reset(self) -> None:
        """Go back to the first frame."""
        self.seek(0)

    def seek(self, frame: int) -> None:
        """Show one frame, and play on from there."""
        with self.lock:
            # The middle of the frame, where rounding does not matter.
            self._time = (frame + 0.5) * self.frame_period
            self._show()

    def advance(self, now: float) -> None:
        """Play up to `now`, s on a steady clock; while paused, nothing moves."""
        with self.lock:
            elapsed = 0.0 if self._last is None else now - self._last
            self._last = now
            if not self.paused:
                self._time = (self._time + elapsed * self._speed) % (self.frames * self.frame_period)
            self._show()

    def _show(self) -> None:
        self.data.qpos[:] = self._positions[self.frame]
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        mujoco.mj_flex(self.model, self.data)
