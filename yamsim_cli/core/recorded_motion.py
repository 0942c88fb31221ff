"""Commands and measurements of arms over time: a recording without images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .geometry.se3 import Array


@dataclass(frozen=True)
class ArmMotion:
    """The motion of one arm; rows are samples.

    Attributes:
        side: `left` or `right` for two arms, empty for a single arm.
        joints: measured joints (n, dof), rad; NaN in samples that have only a command.
        commands: commands (n, dof) of the joints' drives, rad; None if not recorded.
        openings: measured openings (n,) of one finger, m; NaN as for `joints`, None if not recorded.
        commanded_openings: commanded openings (n,) of one finger, m; None if not recorded.
        velocities: measured joint velocities (n, dof), rad/s; NaN as for `joints`, None if not recorded.
    """

    side: str
    joints: Array
    commands: Array | None = None
    openings: Array | None = None
    commanded_openings: Array | None = None
    velocities: Array | None = None


@dataclass(frozen=True)
class RecordedMotion:
    """A recorded motion of one or two arms.

    A command acts from its sample's time until the next sample's.

    Attributes:
        name: name of the recording, for messages.
        times: times (n,) of the samples, s, strictly increasing from 0.
        arms: the motion of each arm, the left arm first.

    Raises:
        ValueError: times do not increase from 0, or an array has another number of rows.
    """

    name: str
    times: Array
    arms: tuple[ArmMotion, ...]

    def __post_init__(self) -> None:
        n = len(self.times)
        if n and (self.times[0] != 0 or np.any(np.diff(self.times) <= 0)):
            raise ValueError("times must begin at 0 and increase")
        for arm in self.arms:
            for rows in (arm.joints, arm.commands, arm.velocities):
                if rows is not None and rows.shape != (n, arm.joints.shape[1]):
                    raise ValueError(f"values have the shape {rows.shape}, not ({n}, {arm.joints.shape[1]})")
            for values in (arm.openings, arm.commanded_openings):
                if values is not None and values.shape != (n,):
                    raise ValueError(f"values have the shape {values.shape}, not ({n},)")

    @property
    def duration(self) -> float:
        """Time of the last sample, s."""
        return float(self.times[-1]) if len(self.times) else 0.0
