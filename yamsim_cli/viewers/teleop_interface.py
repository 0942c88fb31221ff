from __future__ import annotations

import abc
from dataclasses import dataclass

from ..core.geometry.se3 import Array
from .viewed_scene import ViewedScene


@dataclass(frozen=True)
class TeleopStatus:
    """State of a teleoperation session, for display.

    Attributes:
        arm: "left" or "right"; empty for a rig with one arm.
        seconds: length of the recording so far, s.
        episodes, failures, waiting: numbers of attempts; `waiting` ones are not judged yet.
        target_distance: from the target pose of the hand to the nearest reachable pose, m; 0 if reachable.
        at_limit: joints at a joint limit.
        obstacle: that blocks the arm; empty without one.
        gripper_open, magnet: commands of the gripper and the weld; `magnet` is None if grasps hold by friction alone.
        prompt: empty unless it differs between attempts.
        goal: how far the goal of the task is met; empty for tasks without a goal.
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
    is_weld_holding: bool
    message: str
    prompt: str = ""
    goal: str = ""

    @property
    def can_follow(self) -> bool:
        """Whether the hand can reach its target."""
        return not (self.target_distance or self.at_limit or self.obstacle)


class TeleopInterface(ViewedScene):
    """A scene with one or two arms, one of which is teleoperated by a target pose. All methods are thread-safe."""

    @property
    @abc.abstractmethod
    def target_pose(self) -> Array:
        """Target pose (4, 4) of the pinch frame, between the finger tips, in `world`."""

    @property
    @abc.abstractmethod
    def status(self) -> TeleopStatus:
        """State of the session, for display."""

    @abc.abstractmethod
    def switch_arm(self) -> None:
        """Teleoperate the other arm, if the rig has two."""

    @abc.abstractmethod
    def set_target_pose(self, T_pinch_in_world: Array) -> None:
        """Set the target pose (4, 4) of the pinch frame in `world`."""

    @abc.abstractmethod
    def toggle_gripper(self) -> None:
        """Open a closed gripper, or close an open one."""

    @abc.abstractmethod
    def set_weld(self, on: bool) -> None:
        """Switch the weld on or off. The weld takes an object only if the hand is near."""

    @abc.abstractmethod
    def start_recording(self) -> None:
        """Reset the scene to the start of the attempt, and start a recording."""

    @abc.abstractmethod
    def stop_recording(self) -> None:
        """End the recording, which is then judged as success or failure."""

    @abc.abstractmethod
    def pause_unattended(self) -> None:
        """Pause a recording because the last browser page was closed."""

    @abc.abstractmethod
    def discard_recording(self) -> None:
        """End and delete the recording."""
