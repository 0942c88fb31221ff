"""Rotations as description files tell them."""

from __future__ import annotations

import math

import numpy as np

from ..geometry.se3 import Array


def from_rpy(roll: float, pitch: float, yaw: float) -> Array:
    """Rotation (3, 3) of turns about the fixed x, then y, then z axis, rad, as SDFormat and URDF have them."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
