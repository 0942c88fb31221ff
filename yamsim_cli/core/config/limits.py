"""What a robot model's joints can do: `robot_models/<model>/limits.yaml`."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field, FiniteFloat

from ..errors import ConfigError
from ..geometry.se3 import Array
from ..resources import Locations
from .base import Config, Name, ordered
from .loader import validate_file
from .record import RecordConfig
from .rig import ArmConfig
from .units import JointAngle, Offset, Within

_Range = Annotated[tuple[JointAngle, JointAngle], AfterValidator(ordered)]


class JointLimits(Config):
    """One joint.

    Attributes:
        range: between its stops, rad.
        motor_rpm: the motor's no-load speed at the joint, revolutions a minute.
        reported_rad_s: the fastest motion that the drive can report, rad/s.
    """

    name: Name
    range: _Range
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
    ranges: dict[Name, dict[Name, _Range]] = Field(default_factory=dict)

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


class Stops:
    """An arm's stops, and whether joints from outside can be the arm's: every place where joints come in asks here."""

    def __init__(self, arm: ArmConfig, locations: Locations) -> None:
        self._arm = arm.name
        limits = load_limits(arm.model, locations).joints_with(arm.gripper)
        self._names = [joint.name for joint in limits]
        self._low, self._high = np.array([joint.range for joint in limits]).T

    def fault(self, joints: Array, slack: float) -> str | None:
        """What is wrong with joints (6,) or (rows, 6) in rad: the first one beyond its stops, at its worst.

        Args:
            slack: so far beyond a stop, rad, is still believed.

        Returns:
            Such as "arm1.joint2: 106 rad lies outside 0..3.665; is it in degrees? Then give 1.85"; None if all is well.
        """
        rows = np.atleast_2d(joints)
        middle = (self._low + self._high) / 2
        for j, name in enumerate(self._names):
            worst = float(rows[np.abs(rows[:, j] - middle[j]).argmax(), j])
            low, high = float(self._low[j]), float(self._high[j])
            if not low - slack <= worst <= high + slack:
                meant = f"; is it in degrees? Then give {math.radians(worst):.4g}" if abs(worst) > 2 * math.pi else ""
                return f"{self._arm}.{name}: {worst:.4g} rad lies outside {low:.4g}..{high:.4g}{meant}"
        return None


def check_start(config: RecordConfig, locations: Locations) -> None:
    """Make sure that a task's arms can stand at its `start_joints`.

    Raises:
        ConfigError: a joint lies beyond a stop of an arm that does the task.
    """
    for arm in config.acting_arms:
        if fault := Stops(arm, locations).fault(np.array(config.task.start_joints), 0.0):
            raise ConfigError(f"task {config.task.name!r}: start_joints: {fault}")
