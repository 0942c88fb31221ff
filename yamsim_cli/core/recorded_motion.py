from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .geometry.se3 import Array


@dataclass(frozen=True)
class ArmMotion:
    """The motion of one arm; rows are samples. Arrays are None if not recorded.

    Attributes:
        side: `left` or `right` for two arms, empty for a single arm.
        joints: measured joints (n, dof), rad; NaN in samples that have only a command.
        commands: of the joints' drives (n, dof), rad.
        openings: measured openings (n,) of one finger, m; NaN as for `joints`.
        commanded_openings: (n,) of one finger, m.
        velocities: measured joint velocities (n, dof), rad/s; NaN as for `joints`.
    """

    side: str
    joints: Array
    commands: Array | None = None
    openings: Array | None = None
    commanded_openings: Array | None = None
    velocities: Array | None = None


@dataclass(frozen=True)
class RecordedMotion:
    """Commands and measurements of one or two arms, the left one first, without images.

    Times (n,), s, increase strictly from 0, else ValueError is raised. A command acts until the next sample's time.
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
