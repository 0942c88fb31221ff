"""yamsim's tasks as environments of LeRobot, which finds them by this package's name: `--env.type=yamsim`."""

from .config import YamsimEnvConfig
from .environment import YamsimEnv

__all__ = ["YamsimEnv", "YamsimEnvConfig"]
