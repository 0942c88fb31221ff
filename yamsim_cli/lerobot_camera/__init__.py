"""LeRobot cameras with the pictures of `yamsim serve-robot --cameras`: `type: yamsim`.

Importing the package registers the type with LeRobot.
"""

from .camera import YamsimCamera
from .config import YamsimCameraConfig

__all__ = ["YamsimCamera", "YamsimCameraConfig"]
