"""yamsim's tasks as environments of LeRobot, which imports this package to find them: `--env.type=yamsim`."""

from .config import YamsimEnvConfig
from .environment import YamsimEnv

__all__ = ["YamsimEnv", "YamsimEnvConfig"]
