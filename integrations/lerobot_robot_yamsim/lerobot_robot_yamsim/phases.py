"""Which part of LeRobot's cycle a call belongs to: nobody tells a robot, but they are as long as they are."""

from __future__ import annotations

from enum import Enum


class Phase(Enum):
    """An episode is recorded, or people set up the next one."""

    EPISODE = "episode"
    RESET = "reset"


class Phases:
    """Follows `lerobot-record` by the times at which it asks for observations, which it does first in every frame.

    A phase is over with the first frame that begins when its time has passed, as in LeRobot's own loop. Between phases
    it may do other things for as long as it likes, such as saving an episode. Nobody notices here when a key ends an
    episode early.

    Attributes:
        now: the phase of the frame that began last; None before the first.

    Args:
        episode_s, reset_s: how long they last; without an `episode_s`, an episode never ends.
    """

    def __init__(self, episode_s: float | None, reset_s: float | None) -> None:
        self._lengths = {Phase.EPISODE: episode_s, Phase.RESET: reset_s or 0.0}
        self._began = 0.0
        self.now: Phase | None = None

    def begin_frame(self, now: float) -> list[Phase]:
        """The phases that begin with a frame that begins at a time, s, in their order."""
        if self.now is None:
            self.now, self._began = Phase.EPISODE, now
            return [Phase.EPISODE]
        length = self._lengths[self.now]
        if length is None or now - self._began < length:
            return []
        begun = [Phase.EPISODE] if self.now is Phase.RESET else [Phase.RESET]
        if begun[0] is Phase.RESET and not self._lengths[Phase.RESET]:
            begun.append(Phase.EPISODE)
        self.now, self._began = begun[-1], now
        return begun
