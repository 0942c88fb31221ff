"""The options of exports to LeRobot's format."""

from __future__ import annotations

from dataclasses import dataclass

from .real_source import ActionSource


@dataclass(frozen=True)
class LeRobotOptions:
    """What an export holds beside joints and commands.

    Attributes:
        pictures: videos of all cameras, and the cameras' matrices.
        environment_state: where things are, see `core.policies.environment_state`.
    """

    pictures: bool = True
    environment_state: bool = False


# Pictures and joints, as policies for real arms see them.
WHOLE = LeRobotOptions()


@dataclass(frozen=True)
class RealOptions:
    """What an export of real recordings holds.

    Attributes:
        pictures: videos of all cameras, and the cameras' matrices where they are known.
        actions: where they are from.
    """

    pictures: bool = True
    actions: ActionSource = "recorded"


# Pictures, and what was commanded.
RECORDED = RealOptions()
