"""A policy of LeRobot whose weights are its actions."""

from .configuration_played import PlayedConfig
from .modeling_played import PlayedPolicy

__all__ = ["PlayedConfig", "PlayedPolicy"]
