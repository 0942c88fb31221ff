"""Cameras of LeRobot's that see the arms which `yamsim serve-robot --cameras` simulates: `type: yamsim`.

Importing this makes the type known to LeRobot.
"""

from .camera import YamsimCamera
from .config import YamsimCameraConfig

__all__ = ["YamsimCamera", "YamsimCameraConfig"]
