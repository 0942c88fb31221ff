"""What a robot model's joints can do: `robot_models/<model>/limits.yaml`."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import AfterValidator, Field, FiniteFloat

from ..resources import Locations
from .base import Config, Name, ordered
from .loader import validate_file
from .units import JointAngle, Offset, Within

Stops = Annotated[tuple[JointAngle, JointAngle], AfterValidator(ordered)]


class JointLimits(Config):
    """One joint.

    Attributes:
        range: between its stops, rad.
        motor_rpm: the motor's no-load speed at the joint, revolutions a minute.
        reported_rad_s: the fastest motion that the drive can report, rad/s.
    """

    name: Name
    range: Stops
    motor_rpm: Annotated[FiniteFloat, Within("rpm", 1, 10_000)]
    reported_rad_s: Annotated[FiniteFloat, Within("rad/s", 0.1, 1000)]

    @property
    def motor_rad_s(self) -> float:
        """The motor's no-load speed, rad/s."""
        return self.motor_rpm * 2 * math.pi / 60


class ArmLimits(Config):
    """A robot model's joints in order, and what depends on the gripper.

    Attributes:
        fingers: gripper -> stops of one finger, m.
        ranges: gripper -> joint -> stops, rad, where they are not those in `joints`.
    """

    joints: Annotated[tuple[JointLimits, ...], Field(min_length=1)]
    fingers: dict[Name, Annotated[tuple[Offset, Offset], AfterValidator(ordered)]]
    ranges: dict[Name, dict[Name, Stops]] = Field(default_factory=dict)

    def joints_with(self, gripper: str | None) -> tuple[JointLimits, ...]:
        """The joints with a gripper; with None, which stands for an unknown one, as far as they go with any."""
        others = [self.ranges.get(gripper, {})] if gripper else [{}, *self.ranges.values()]

        def stops(joint: JointLimits) -> tuple[float, float]:
            found = [other.get(joint.name, joint.range) for other in others]
            return min(low for low, _ in found), max(high for _, high in found)

        return tuple(joint.model_copy(update={"range": stops(joint)}) for joint in self.joints)


def load_limits(model: str, locations: Locations) -> ArmLimits:
    """The limits of a robot model.

    Raises:
        ResourceError: there is no such file.
        ConfigError: it is not valid.
    """
    return validate_file(ArmLimits, locations.file(f"robot_models/{model}/limits.yaml"), locations)
