"""yamsim's arms as a robot of LeRobot, which finds it by this package's name: `--robot.type=yamsim`.

The package also has an expert that drives the arms, `--teleop.type=yamsim_expert`, and for other robots the camera type
`yamsim` of `yamsim serve-robot --cameras`.
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
