"""A LeRobot camera, `type: yamsim`, that reads the simulated pictures of `yamsim serve-robot --cameras`.

The import of this package registers the type with LeRobot.
"""

from .camera import YamsimCamera
from .config import YamsimCameraConfig

__all__ = ["YamsimCamera", "YamsimCameraConfig"]
