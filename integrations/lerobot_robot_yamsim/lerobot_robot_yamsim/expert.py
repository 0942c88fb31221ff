"""The task's expert as a teleoperator of LeRobot."""

from __future__ import annotations

from typing import Any

from lerobot.teleoperators import Teleoperator
from lerobot.utils.errors import DeviceNotConnectedError

from .config import YamsimExpertConfig
from .phases import link_of


class YamsimExpert(Teleoperator):
    """Plays yamsim's expert in each episode, and holds the arms between episodes."""

    config_class = YamsimExpertConfig
    name = "yamsim_expert"

    def __init__(self, config: YamsimExpertConfig) -> None:
        super().__init__(config)
        self._link = link_of(config.robot_id)
        self._robot_id = config.robot_id

    @property
    def action_features(self) -> dict[str, type]:
        """The robot's: name of a joint or gripper with `.pos` -> float."""
        return dict.fromkeys(self._link.keys, float)

    @property
    def feedback_features(self) -> dict[str, type]:
        """None."""
        return {}

    @property
    def is_connected(self) -> bool:
        """Whether the robot uses the expert."""
        return self._link.expert

    def connect(self, calibrate: bool = True) -> None:
        """Make the robot begin episodes that the expert can do."""
        self._link.expert = True

    @property
    def is_calibrated(self) -> bool:
        """Always."""
        return True

    def calibrate(self) -> None:
        """Do nothing."""

    def configure(self) -> None:
        """Do nothing."""

    def get_action(self) -> dict[str, Any]:
        """The action for this frame: name of a joint or gripper with `.pos` -> rad, or a share.

        Raises:
            DeviceNotConnectedError: the simulated robot of that id is not connected.
        """
        if self._link.action is None:
            raise DeviceNotConnectedError(
                f"--teleop.type=yamsim_expert drives --robot.type=yamsim with --robot.id={self._robot_id}, and no such "
                "robot is connected in this process; give --teleop.robot_id the id of the robot"
            )
        return dict(self._link.action)

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Do nothing."""

    def disconnect(self) -> None:
        """Stop driving the robot."""
        self._link.expert = False
