"""A CAN bus with motors on it: who hears what, and what gets lost."""

from __future__ import annotations

import random
from collections.abc import Sequence

from .faults import DROP, HOT, LOST, STUCK, Fault
from .frames import Frame
from .motor import Motor

# How often temperatures and patience are looked at, s.
_LOOK_SECONDS = 0.01


class Bus:
    """A bus. Time is what whoever simulates says it is, s.

    Attributes:
        channel: its name, such as `can0`.
        motors: on it.
        stuck: whether the gripper does not move.
        heard, dropped: frames that came, and that got lost in either direction.

    Args:
        seed: from which follows which frames get lost.
    """

    def __init__(self, channel: str, motors: Sequence[Motor], faults: Sequence[Fault] = (), seed: int = 0) -> None:
        self.channel = channel
        self.motors = tuple(motors)
        self.stuck = False
        self.heard = self.dropped = 0
        self._faults = [fault for fault in faults if fault.channel in ("", channel)]
        self._random = random.Random(f"{seed} {channel}")
        self._looked = 0.0
        self._drop_share = 0.0

    def send(self, frame: Frame, now: float) -> list[Frame]:
        """Put a frame onto the bus; what is answered."""
        self.heard += 1
        if self._loses():
            return []
        answers = [answer for motor in self.motors if (answer := motor.hear(frame, now)) is not None]
        return [answer for answer in answers if not self._loses()]

    def passes(self, now: float) -> None:
        """Let it be so late, s: motors warm up and lose patience, and faults come and go."""
        if (seconds := now - self._looked) < _LOOK_SECONDS:
            return
        self._looked = now
        acting = [fault for fault in self._faults if fault.acts(self.channel, now)]
        self.stuck = any(fault.kind == STUCK for fault in acting)
        self._drop_share = max((fault.share for fault in acting if fault.kind == DROP), default=0.0)
        lost = {fault.motor for fault in acting if fault.kind == LOST}
        hot = {fault.motor: fault.celsius for fault in acting if fault.kind == HOT}
        for motor in self.motors:
            if motor.number in hot:
                motor.celsius = hot[motor.number]
            motor.passes(now, seconds)
            if motor.lost and motor.number not in lost:
                motor.plug_in()
            elif not motor.lost and motor.number in lost:
                motor.unplug()

    def _loses(self) -> bool:
        lost = self._drop_share > 0 and self._random.random() < self._drop_share
        self.dropped += lost
        return lost
