"""What a page needs of an arm that a person drives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from ..geometry.se3 import Array
from .shown import Shown


@dataclass(frozen=True)
class DriveStatus:
    """How things stand, for a person to read.

    Attributes:
        arm: which arm is driven, "left" or "right"; empty where there is but one.
        recording: whether what happens is recorded, and since how many seconds.
        episodes, failures, waiting: successes in the dataset, attempts that failed, and those not judged yet.
        apart: how far the target is out of the arm's reach, m; 0 where the hand can be there.
        at_limit: joints that have come to a stop.
        blocked: what is in the arm's way; empty where nothing is.
        gripper_open, magnet, holds: what was asked of the gripper and the magnet, and whether it holds the object.
        message: what came of the last thing that was asked for.
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
    magnet: bool
    holds: bool
    message: str

    @property
    def free(self) -> bool:
        """Whether the hand can go where it is told."""
        return not (self.apart or self.at_limit or self.blocked)


class Driven(Shown, Protocol):
    """An arm that follows a target, or one of two arms. Its methods may be called from any thread."""

    @property
    def target(self) -> Array:
        """Where the pinch frame, between the finger tips, is to be: pose (4, 4) in `world`."""
        ...

    @property
    def status(self) -> DriveStatus:
        """How things stand."""
        ...

    def switch_arm(self) -> None:
        """Drive the other arm, if there is one."""
        ...

    def aim(self, T_pinch_in_world: Array) -> None:
        """Give the hand another target (4, 4)."""
        ...

    def toggle_gripper(self) -> None:
        """Open the gripper, or close it to what the object needs."""
        ...

    def set_magnet(self, on: bool) -> None:
        """Switch the magnet, which holds the object where the hand is at it."""
        ...

    def start(self) -> None:
        """Record from the attempt's beginning."""
        ...

    def stop(self) -> None:
        """End the recording, to be judged."""
        ...

    def leave(self) -> None:
        """Nobody watches any more: a recording stands still until somebody plays on."""
        ...

    def discard(self) -> None:
        """End the recording as if it had never been."""
        ...
