"""The phases of `lerobot-record`, and the values that a robot and its expert share in one process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum


@dataclass
class ExpertLink:
    """The values that a robot and its expert share, since LeRobot makes each of them separately.

    Attributes:
        keys: names of the robot's joints and grippers, with `.pos`.
        expert: whether an expert is connected, so that episodes have to be ones that the expert can do.
        action: the expert's present action, key -> rad, or a share; None if no robot is connected.
    """

    keys: tuple[str, ...] = ()
    expert: bool = False
    action: Mapping[str, float] | None = None


_LINKS: dict[str | None, ExpertLink] = {}


def link_of(robot: str | None) -> ExpertLink:
    """The link of the robot with an id."""
    return _LINKS.setdefault(robot, ExpertLink())


class Phase(Enum):
    """Recording an episode, or setting up the next one."""

    EPISODE = "episode"
    RESET = "reset"


class Phases:
    """Derives the phases of `lerobot-record` from the times of its observations, the first call of each frame.

    A phase ends with the first frame that begins after its duration, as in LeRobot's own loop. Time between phases,
    such as for saving an episode, does not count. A key that ends an episode early is not noticed.

    Attributes:
        now: the phase of the last frame; None before the first.

    Args:
        episode_s, reset_s: durations; without an `episode_s`, an episode never ends.
    """

    def __init__(self, episode_s: float | None, reset_s: float | None) -> None:
        self._lengths = {Phase.EPISODE: episode_s, Phase.RESET: reset_s or 0.0}
        self._began = 0.0
        self.now: Phase | None = None

    def begin_frame(self, now: float) -> list[Phase]:
        """The phases that begin with a frame at a time, s, in their order."""
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
