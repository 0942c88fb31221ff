"""A simulated CAN bus with motors and injected faults."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from yamsim_cli.core.errors import UsageError

from .can_frames import CanFrame
from .motor import Motor

_UPDATE_SECONDS = 0.01  # s

LOST, HOT, DROP, STUCK = "lost", "hot", "drop", "stuck"
# Fault -> its own keys in a `--fault` flag, besides _COMMON.
_FAULT_KEYS = {LOST: ("motor",), HOT: ("motor", "celsius"), DROP: ("share",), STUCK: ()}
_COMMON_KEYS = ("channel", "at", "for")
# Valid values; `at` and `for` in s, `celsius` in degrees Celsius.
_RANGES = {"motor": (1, 15), "at": (0, 86_400), "for": (0, 86_400), "celsius": (0, 250), "share": (0, 1)}
_FIELD_OF_KEY = {"at": "start_time", "for": "seconds", "share": "lost_frame_share"}  # where the names differ
_EXAMPLE = "lost:motor=3,at=5,for=2"


@dataclass(frozen=True)
class BusFault:
    """A fault to inject into a bus.

    Attributes:
        kind: LOST, HOT, DROP or STUCK.
        channel: empty for all buses.
        start_time, seconds: start and duration in simulation time.
        celsius: of a hot rotor.
        lost_frame_share: of dropped frames, in each direction.
    """

    kind: str
    channel: str = ""
    motor: int = 0
    start_time: float = 0.0
    seconds: float = float("inf")
    celsius: float = 110.0
    lost_frame_share: float = 0.1


def parse_fault(text: str) -> BusFault:
    """Parse a `--fault` flag, such as `lost:motor=3,at=5,for=2`.

    Raises:
        UsageError: the text is invalid; the message lists valid values.
    """
    kind, _, rest = text.partition(":")
    if kind not in _FAULT_KEYS:
        raise UsageError(
            f"--fault {text!r}: unknown fault {kind!r}; valid: {', '.join(_FAULT_KEYS)}, such as {_EXAMPLE}"
        )
    valid = (*_FAULT_KEYS[kind], *_COMMON_KEYS)
    given: dict[str, Any] = {}
    for part in filter(None, rest.split(",")):
        key, _, value = part.partition("=")
        if key not in valid:
            raise UsageError(f"--fault {text!r}: a {kind} fault has no {key!r}; valid: {', '.join(valid)}")
        field = _FIELD_OF_KEY.get(key, key)
        if field in given:
            raise UsageError(f"--fault {text!r}: {key} is given twice")
        given[field] = value if key == "channel" else _parse_fault_number(text, key, value)
    if "motor" in valid and "motor" not in given:
        raise UsageError(f"--fault {text!r}: give a motor, as in {kind}:motor=3")
    return BusFault(kind, **given)


def _parse_fault_number(text: str, key: str, value: str) -> float:
    low, high = _RANGES[key]
    try:
        number = float(value)
    except ValueError:
        number = float("nan")
    if not low <= number <= high or (key == "motor" and not number.is_integer()):
        raise UsageError(f"--fault {text!r}: {key} {value!r} is not valid; it must lie in {low}..{high}")
    return int(number) if key == "motor" else number


class MotorBus:
    """A CAN bus with motors and faults. Times are simulation time, s.

    Attributes:
        stuck: the gripper is stuck.
        frames_received, dropped: frames, dropped in either direction.

    Args:
        seed: of the choice of dropped frames.
    """

    def __init__(self, channel: str, motors: Sequence[Motor], faults: Sequence[BusFault] = (), seed: int = 0) -> None:
        self.channel = channel
        self.motors = tuple(motors)
        self.is_gripper_stuck = False
        self.frames_received = self.frames_dropped = 0
        self._faults = [fault for fault in faults if fault.channel in ("", channel)]
        self._random = random.Random(f"{seed} {channel}")
        self._updated = 0.0
        self._drop_share = 0.0

    def send(self, frame: CanFrame, now: float) -> list[CanFrame]:
        """Send a frame to all motors; return answers that no fault drops."""
        self.frames_received += 1
        if self._loses_next_frame():
            return []
        answers = [answer for motor in self.motors if (answer := motor.answer_frame(frame, now)) is not None]
        return [answer for answer in answers if not self._loses_next_frame()]

    def advance_to(self, now: float) -> None:
        """Advance to `now`, s: update motors, and begin and end faults."""
        if (seconds := now - self._updated) < _UPDATE_SECONDS:
            return
        self._updated = now
        acting = [fault for fault in self._faults if fault.start_time <= now < fault.start_time + fault.seconds]
        self.is_gripper_stuck = any(fault.kind == STUCK for fault in acting)
        self._drop_share = max((fault.lost_frame_share for fault in acting if fault.kind == DROP), default=0.0)
        lost = {fault.motor for fault in acting if fault.kind == LOST}
        hot = {fault.motor: fault.celsius for fault in acting if fault.kind == HOT}
        for motor in self.motors:
            if motor.number in hot:
                motor.celsius = hot[motor.number]
            motor.advance(now, seconds)
            if motor.is_unplugged and motor.number not in lost:
                motor.power_on()
            elif not motor.is_unplugged and motor.number in lost:
                motor.power_off()

    def _loses_next_frame(self) -> bool:
        lost = self._drop_share > 0 and self._random.random() < self._drop_share
        self.frames_dropped += lost
        return lost
