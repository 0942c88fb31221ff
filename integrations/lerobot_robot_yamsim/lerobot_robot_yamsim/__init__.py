"""yamsim's arms as a robot of LeRobot, which imports this package to find it: `--robot.type=yamsim`.

An expert that drives them comes with it: `--teleop.type=yamsim_expert`. So do the cameras of `yamsim serve-robot
--cameras`, for any other robot: the camera type `yamsim`.
"""

from yamsim_cli.lerobot_camera import YamsimCamera, YamsimCameraConfig

from .config import YamsimExpertConfig, YamsimRobotConfig
from .expert import YamsimExpert
from .robot import YamsimRobot

__all__ = [
    "YamsimCamera",
    "YamsimCameraConfig",
    "YamsimExpert",
    "YamsimExpertConfig",
    "YamsimRobot",
    "YamsimRobotConfig",
]
