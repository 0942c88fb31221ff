"""The interface between a page and the arm that a person drives on it."""

from __future__ import annotations

import abc
from dataclasses import dataclass

from ..core.geometry.se3 import Array
from .viewed_scene import ViewedScene


@dataclass(frozen=True)
class TeleopStatus:
    """The state of a session, for a person to read.

    Attributes:
        arm: the driven arm, "left" or "right"; empty for a lone arm.
        recording: whether an attempt is being recorded.
        seconds: length of the recording so far, s.
        episodes, failures, waiting: numbers of episodes in the dataset, of failed attempts, and of those to be judged.
        target_distance: distance from the target to the nearest pose in the arm's reach, m; 0 if the target is in reach.
        at_limit: joints that are at a stop.
        obstacle: name of an obstacle in the arm's path; empty without one.
        gripper_open, magnet: commands of the gripper and the magnet; `magnet` is None where friction alone holds.
        magnet_holds: whether the magnet holds the object.
        message: the result of the last command.
        prompt: the task in words, where they differ between attempts.
        goal: how far the task's goal is met; empty for tasks without one.
    """

    arm: str
    recording: bool
    seconds: float
    episodes: int
    failures: int
    waiting: int
    target_distance: float
    at_limit: tuple[str, ...]
    obstacle: str
    gripper_open: bool
    magnet: bool | None
    magnet_holds: bool
    message: str
    prompt: str = ""
    goal: str = ""

    @property
    def can_follow(self) -> bool:
        """Whether the hand can follow its target."""
        return not (self.target_distance or self.at_limit or self.obstacle)


class TeleopInterface(ViewedScene):
    """A lone arm, or one of two arms, that follows a target. Its methods may be called from any thread."""

    @property
    @abc.abstractmethod
    def target(self) -> Array:
        """The target pose (4, 4) of the pinch frame between the finger tips, in `world`."""

    @property
    @abc.abstractmethod
    def status(self) -> TeleopStatus:
        """The state of the session."""

    @abc.abstractmethod
    def switch_arm(self) -> None:
        """Drive the other arm, if there is one."""

    @abc.abstractmethod
    def set_target_pose(self, T_pinch_in_world: Array) -> None:
        """Set the hand's target (4, 4)."""

    @abc.abstractmethod
    def toggle_gripper(self) -> None:
        """Open the gripper, or close it."""

    @abc.abstractmethod
    def set_magnet(self, on: bool) -> None:
        """Switch the magnet on or off. The magnet takes the object only if the hand is near the object."""

    @abc.abstractmethod
    def start(self) -> None:
        """Start the attempt anew, and record it."""

    @abc.abstractmethod
    def stop(self) -> None:
        """End the recording, which is then judged."""

    @abc.abstractmethod
    def pause_unattended(self) -> None:
        """Pause a recording until somebody resumes it: the last page was closed."""

    @abc.abstractmethod
    def discard(self) -> None:
        """End the recording, and forget it."""
