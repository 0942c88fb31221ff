"""yamsim's arms as a robot of LeRobot, which imports this package to find it: `--robot.type=yamsim`.

An expert that drives them comes with it: `--teleop.type=yamsim_expert`.
"""

from .config import YamsimExpertConfig, YamsimRobotConfig
from .expert import YamsimExpert
from .robot import YamsimRobot

__all__ = ["YamsimExpert", "YamsimExpertConfig", "YamsimRobot", "YamsimRobotConfig"]
