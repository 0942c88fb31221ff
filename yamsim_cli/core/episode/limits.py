"""Which joint limits no demonstration may exceed."""

from __future__ import annotations

import math

from ..types import Margins

STOP_SLACK = 0.01  # rad, how far beyond its stop a joint may be; stops are soft in physics


def limits_fault(margins: Margins) -> str | None:
    """Return the figures of a motion that exceeds a motor's speed, a drive's torque or a joint's stop; None if none."""
    if margins.velocity <= 1 and margins.torque < 1 and margins.joint >= -STOP_SLACK:
        return None
    return (
        f"a joint at {margins.velocity:.0%} of its motor's speed, a drive at {margins.torque:.0%} of its torque, "
        f"{math.degrees(margins.joint):.1f} deg from the nearest stop"
    )
