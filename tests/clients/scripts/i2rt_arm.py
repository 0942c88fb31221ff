"""The manufacturer's SDK, unmodified, on a simulated arm. Prints what it found and did as JSON.

python i2rt_arm.py CHANNEL HOLD_SECONDS FLOAT_SECONDS
"""

from __future__ import annotations

import json
import logging
import sys
import time

import numpy as np
from i2rt.robots.get_robot import get_yam_robot
from i2rt.robots.utils import ArmType, GripperType

POSE = np.array([0.3, 1.2, 1.2, -0.2, 0.1, 0.2, 0.5])


def main() -> None:
    channel, hold, drift = sys.argv[1], float(sys.argv[2]), float(sys.argv[3])
    began = time.monotonic()
    robot = get_yam_robot(channel, ArmType.YAM, GripperType.LINEAR_4310)
    up = time.monotonic() - began
    try:
        told = {"up_s": up, "gripper_limits": robot.get_robot_info()["gripper_limits"].tolist()}
        robot.move_joints(POSE, 3.0)
        time.sleep(1.0)
        told["hold"] = _hold(robot, hold)
        robot.enter_gravity_comp_idle()
        time.sleep(0.2)
        before = robot.get_joint_pos().copy()
        time.sleep(drift)
        told["drift_rad"] = float(np.abs(robot.get_joint_pos() - before)[:6].max())
        robot.command_joint_pos(np.append(POSE[:6], 0.0))
        time.sleep(2.0)
        told["closed"] = float(robot.get_joint_pos()[6])
        told["temperature"] = [state.temp_rotor for state in robot.motor_chain.read_states()]
    finally:
        logging.disable()
        robot.close()
        # Its loop, which still runs, reports that the bus was closed.
        time.sleep(0.5)
    print(json.dumps(told))


def _hold(robot: object, seconds: float) -> dict[str, float]:
    """Return the period of the SDK's loop while it holds a pose, and its position error."""
    recorder = robot.motor_chain._rate_recorder
    turned, track = [], recorder.track

    def note() -> None:
        turned.append(time.perf_counter())
        track()

    recorder.track = note
    off = 0.0
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        time.sleep(0.05)
        off = max(off, float(np.abs(robot.get_joint_pos() - POSE)[:6].max()))
    recorder.track = track
    period = np.diff(turned) * 1000
    p50, p95, p99 = np.percentile(period, (50, 95, 99))
    return {
        "turns": len(turned),
        "hz": 1000 / float(period.mean()),
        "p50_ms": float(p50),
        "p95_ms": float(p95),
        "p99_ms": float(p99),
        "max_ms": float(period.max()),
        "off_rad": off,
    }


main()
