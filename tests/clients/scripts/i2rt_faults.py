"""The manufacturer's SDK on a faulty motor: JSON of its messages. `python i2rt_faults.py CHANNEL SECONDS`."""

from __future__ import annotations

import contextlib
import io
import json
import sys
import time

from i2rt.robots.get_robot import get_yam_robot
from i2rt.robots.utils import ArmType, GripperType


def main() -> None:
    channel, seconds = sys.argv[1], float(sys.argv[2])
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        robot = get_yam_robot(channel, ArmType.YAM, GripperType.LINEAR_4310)
        end = time.monotonic() + seconds
        while time.monotonic() < end and robot.motor_chain.running:
            time.sleep(0.05)
        running = robot.motor_chain.running
        said_so_far = said.getvalue()
        robot.close()
        time.sleep(0.5)
    print(json.dumps({"running": running, "said": said_so_far}))


main()
