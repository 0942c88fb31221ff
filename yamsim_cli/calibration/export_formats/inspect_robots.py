"""Bases of both arms in a `config.ini` of inspect-robots-yam, which checks collisions with them.

Source: robocurve/inspect-robots-yam d444fa9, `config.py` (names of the keys), `collision.py` (m and rad, z up) and the
README's "Collision guardrail".
"""

from __future__ import annotations

import configparser
import io
import math

from ...core.config.rig import RigConfig
from ...core.files.resources import Locations
from ...core.geometry.se3 import pose, rotation_z, tilt_angle, yaw
from ..calibration_file import Calibration
from .format_files import FormatFiles, measured_right_base

CONFIG_FILE = "config.ini"
# rad, the smallest reported tilt: at a reach of 0.7 m, it moves the hand by 1.2 mm, about the penetration that the
# checker tolerates. Source: inspect-robots-yam d444fa9, `collision.py`, `penetration_threshold`, 1 mm.
_REPORTED_TILT = math.radians(0.1)


def write_inspect_robots(calibration: Calibration, rig: RigConfig, locations: Locations) -> FormatFiles:
    """Return `config.ini` with the positions (m) and yaws (rad) of both bases; none if the right base is unknown.

    The left base is at the origin with yaw 0. The right base is in axes whose z is up: the left base's tilt in them is
    the rig's, because the calibration does not measure it.
    """
    T_right_in_left, reason = measured_right_base(calibration)
    if T_right_in_left is None:
        return FormatFiles({}, (f"inspect_robots: config.ini: {reason}",))
    T_left_in_world = rig.T_base_in_world(rig.recording_order[0])
    T_left = pose(rotation=rotation_z(-yaw(T_left_in_world)) @ T_left_in_world[:3, :3])
    bases = {"left": T_left, "right": T_left @ T_right_in_left}
    values: dict[str, str] = {}
    left_out = []
    for side, T in bases.items():
        values[f"collision_{side}_base_pos"] = ",".join(_decimal(value) for value in T[:3, 3])
        values[f"collision_{side}_base_yaw"] = _decimal(yaw(T))
        tilt = tilt_angle(T[:3, :3])
        if tilt > _REPORTED_TILT:
            left_out.append(
                f"inspect_robots: tilt of the {side} base, {math.degrees(tilt):.2f} degrees: config.ini has only yaw"
            )
    config = configparser.ConfigParser(interpolation=None)
    config["embodiment.args"] = values
    text = io.StringIO()
    config.write(text)
    return FormatFiles({CONFIG_FILE: text.getvalue()}, tuple(left_out))


def _decimal(value: float) -> str:
    return f"{round(float(value), 6) + 0.0:.6f}"  # 0.0 instead of -0.0
