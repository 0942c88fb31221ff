"""A policy of LeRobot whose weights are the actions that it answers with, which LeRobot imports to find it."""

from .configuration_played import PlayedConfig
from .modeling_played import PlayedPolicy

__all__ = ["PlayedConfig", "PlayedPolicy"]
