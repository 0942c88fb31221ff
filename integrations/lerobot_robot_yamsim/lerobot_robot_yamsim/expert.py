"""The task's expert as a teleoperator of LeRobot."""

from __future__ import annotations

from typing import Any

from lerobot.teleoperators import Teleoperator
from lerobot.utils.errors import DeviceNotConnectedError

from .config import YamsimExpertConfig
from .desk import desk_of


class YamsimExpert(Teleoperator):
    """Does in each episode what yamsim's expert does from there; between episodes it waits."""

    config_class = YamsimExpertConfig
    name = "yamsim_expert"

    def __init__(self, config: YamsimExpertConfig) -> None:
        super().__init__(config)
        self._desk = desk_of(config.robot_id)
        self._robot_id = config.robot_id

    @property
    def action_features(self) -> dict[str, type]:
        """Those of the robot that it drives: name of a joint or gripper with `.pos` -> float."""
        return dict.fromkeys(self._desk.keys, float)

    @property
    def feedback_features(self) -> dict[str, type]:
        """None."""
        return {}

    @property
    def is_connected(self) -> bool:
        """Whether the robot knows that it is there."""
        return self._desk.expert

    def connect(self, calibrate: bool = True) -> None:
        """Have the robot begin episodes that it can do."""
        self._desk.expert = True

    @property
    def is_calibrated(self) -> bool:
        """Always."""
        return True

    def calibrate(self) -> None:
        """There is nothing to calibrate."""

    def configure(self) -> None:
        """There is nothing to configure."""

    def get_action(self) -> dict[str, Any]:
        """What it does in this frame: name of a joint or gripper with `.pos` -> rad, or a share.

        Raises:
            DeviceNotConnectedError: no simulated robot is connected that it could drive.
        """
        if self._desk.action is None:
            raise DeviceNotConnectedError(
                f"--teleop.type=yamsim_expert drives --robot.type=yamsim with --robot.id={self._robot_id}, and no such "
                "robot is connected in this process; give --teleop.robot_id the id of the robot"
            )
        return dict(self._desk.action)

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """It feels nothing."""

    def disconnect(self) -> None:
        """Leave."""
        self._desk.expert = False
