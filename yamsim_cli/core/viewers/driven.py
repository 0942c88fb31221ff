"""The interface between a page and the arm that a person drives on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from ..geometry.se3 import Array
from .shown import Shown


@dataclass(frozen=True)
class DriveStatus:
    """The state of a session, for a person to read.

    Attributes:
        arm: which arm is driven, "left" or "right"; empty for a lone arm.
        recording: whether a recording goes on.
        seconds: length of the recording so far, s.
        episodes, failures, waiting: numbers of episodes in the dataset, of failed attempts, and of those to be judged.
        apart: how far the target is out of the arm's reach, m; 0 if the hand can be there.
        at_limit: joints that are at a stop.
        blocked: what is in the arm's way; empty if nothing is.
        gripper_open, magnet: what the gripper and the magnet were told; None where friction alone holds.
        holds: whether the magnet holds the object.
        message: the result of the last command.
        prompt: what is to be done, where that differs between attempts.
        goal: how its goal stands, of a task that has one.
    """

    arm: str
    recording: bool
    seconds: float
    episodes: int
    failures: int
    waiting: int
    apart: float
    at_limit: tuple[str, ...]
    blocked: str
    gripper_open: bool
    magnet: bool | None
    holds: bool
    message: str
    prompt: str = ""
    goal: str = ""

    @property
    def free(self) -> bool:
        """Whether the hand can follow its target."""
        return not (self.apart or self.at_limit or self.blocked)


class Driven(Shown, Protocol):
    """A lone arm, or one of two arms, that follows a target. Its methods may be called from any thread."""

    @property
    def target(self) -> Array:
        """The target pose (4, 4) of the pinch frame between the finger tips, in `world`."""
        ...

    @property
    def status(self) -> DriveStatus:
        """The state of the session."""
        ...

    def switch_arm(self) -> None:
        """Drive the other arm, if there is one."""
        ...

    def aim(self, T_pinch_in_world: Array) -> None:
        """Set the hand's target (4, 4)."""
        ...

    def toggle_gripper(self) -> None:
        """Open the gripper, or close it."""
        ...

    def set_magnet(self, on: bool) -> None:
        """Switch the magnet on or off. It takes the object only if the hand is near it."""
        ...

    def start(self) -> None:
        """Start the attempt anew, and record it."""
        ...

    def stop(self) -> None:
        """End the recording, which is then judged."""
        ...

    def leave(self) -> None:
        """Note that nobody watches any more: a recording pauses until somebody resumes it."""
        ...

    def discard(self) -> None:
        """End the recording, and forget it."""
        ...
