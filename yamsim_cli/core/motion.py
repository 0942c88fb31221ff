"""What arms were told and what they did, over time: a recording without its pictures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .geometry.se3 import Array


@dataclass(frozen=True)
class ArmMotion:
    """One arm of a motion; rows are samples.

    Attributes:
        side: `left` or `right` of two arms, empty of a lone one.
        joints: where the joints were measured (n, dof), rad; NaN in samples that have a command alone.
        commands: where the drives were told to go (n, dof), rad; None where nobody recorded it.
        openings: opening of one finger as measured (n,), m, NaN likewise; None where nobody recorded it.
        commanded_openings: the opening that was told (n,), m; None likewise.
        velocities: of the joints as measured (n, dof), rad/s, NaN likewise; None where nobody recorded them.
    """

    side: str
    joints: Array
    commands: Array | None = None
    openings: Array | None = None
    commanded_openings: Array | None = None
    velocities: Array | None = None


@dataclass(frozen=True)
class Motion:
    """A recorded motion of one arm or two.

    A command acts from its sample's time on, until the next sample's. What was not recorded is None, and not made up.

    Attributes:
        name: where it was read from, for messages.
        times: of the samples (n,), s, strictly increasing, the first one 0.
        arms: the left arm first.
    """

    name: str
    times: Array
    arms: tuple[ArmMotion, ...]

    def __post_init__(self) -> None:
        """Holds it to its shapes.

        Raises:
            ValueError: times do not increase, or rows are not as many as they are: readers tell their users before.
        """
        n = len(self.times)
        if n and (self.times[0] != 0 or np.any(np.diff(self.times) <= 0)):
            raise ValueError("times begin at 0 and increase")
        for arm in self.arms:
            for rows in (arm.joints, arm.commands, arm.velocities):
                if rows is not None and rows.shape != (n, arm.joints.shape[1]):
                    raise ValueError(f"{rows.shape} are not ({n}, {arm.joints.shape[1]})")
            for values in (arm.openings, arm.commanded_openings):
                if values is not None and values.shape != (n,):
                    raise ValueError(f"{values.shape} are not ({n},)")

    @property
    def duration(self) -> float:
        """From the first sample to the last, s."""
        return float(self.times[-1]) if len(self.times) else 0.0
