"""The options of an export to LeRobot's format."""

from __future__ import annotations

from dataclasses import dataclass


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
