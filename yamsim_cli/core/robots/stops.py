"""Whether joints from outside can be an arm's: every place where joints come in asks here."""

from __future__ import annotations

import math

import numpy as np

from ..geometry.se3 import Array
from .robot import Robot


def beyond_stops(name: str, robot: Robot, joints: Array, slack: float) -> str | None:
    """What is wrong with joints (dof,) or (rows, dof) in rad: the first one beyond its stops, at its worst.

    Args:
        name: of the arm, for the message.
        slack: so far beyond a stop, rad, is still believed.

    Returns:
        Such as "arm1.joint2: 106 rad lies outside 0..3.665; is it in degrees? Then give 1.85"; None if all is well.
    """
    rows = np.atleast_2d(joints)
    for j, joint in enumerate(robot.joints):
        low, high = joint.range
        worst = float(rows[np.abs(rows[:, j] - (low + high) / 2).argmax(), j])
        if not low - slack <= worst <= high + slack:
            meant = f"; is it in degrees? Then give {math.radians(worst):.4g}" if abs(worst) > 2 * math.pi else ""
            return f"{name}.{joint.name}: {worst:.4g} rad lies outside {low:.4g}..{high:.4g}{meant}"
    return None
