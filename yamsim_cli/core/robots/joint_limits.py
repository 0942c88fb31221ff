from __future__ import annotations

import math

import numpy as np

from ..geometry.se3 import Array
from .robot import Robot


def describe_limit_violation(name: str, robot: Robot, joints: Array, slack: float) -> str | None:
    """Return an error message for the first joint beyond its limits by more than `slack` rad; None if there is none.

    Joints are (dof,) or (rows, dof), rad. The message is such as "arm1.joint2: 106 rad lies outside 0..3.665; is it in
    degrees? Then give 1.85".
    """
    rows = np.atleast_2d(joints)
    for j, joint in enumerate(robot.joints):
        low, high = joint.range
        worst = float(rows[np.abs(rows[:, j] - (low + high) / 2).argmax(), j])
        if not low - slack <= worst <= high + slack:
            meant = f"; is it in degrees? Then give {math.radians(worst):.4g}" if abs(worst) > 2 * math.pi else ""
            return f"{name}.{joint.name}: {worst:.4g} rad lies outside {low:.4g}..{high:.4g}{meant}"
    return None
