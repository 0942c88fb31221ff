"""Let motors wait without limit for their next frame: `motors_wait.py CHANNEL...`.

They disable themselves after 400 ms, and a busy machine stops a program for longer. The maker's tool is
`set_timeout`, which writes the same register of one motor.
"""

from __future__ import annotations

import json
import sys

import can

BROADCAST, WRITE, TIMEOUT = 0x7FF, 0x55, 9


def main(*channels: str) -> None:
    answers = 0
    for channel in channels:
        with can.Bus(interface="socketcan", channel=channel) as bus:
            for motor in range(1, 8):
                bus.send(
                    can.Message(
                        arbitration_id=BROADCAST, data=[motor, 0, WRITE, TIMEOUT, 0, 0, 0, 0], is_extended_id=False
                    )
                )
                answers += bus.recv(60) is not None
    print(json.dumps({"answers": answers}))


if __name__ == "__main__":
    main(*sys.argv[1:])
