"""Passive leader arms (GELLO) on CAN buses, which perform a recorded motion in front of a teleoperation program.

Every joint and the trigger have an encoder that broadcasts its angle. Source of the frames: `utils/encoder_manager.py`
in the maker's SDK 1.3.6. Source of directions, trigger and buttons: `config.py` and `robot/passive_gello.py` in the
maker's yam-abc-reproduce, commit 7d9f9d1.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.recorded_motion import ArmMotion, RecordedMotion

from ..motors.can_frames import CanFrame
from ..recordings.motion_reading import read_motions
from .can_bus import KernelBus, UnixBus
from .served_arms import ServedArms

LEADER_CHANNELS = ("can_lead_l", "can_lead_r")  # names of the maker's udev rules, of the left and the right leader

_REQUEST_ID, _REPORT_ID = 0x50E, 0x50F
_SET_ZERO, _SET_FREQUENCY, _ASK_REPORT = 0x00, 0x01, 0x02  # second byte of a request
_ALL_DEVICES = 0xFF
_REPORT = struct.Struct(">BhhB")  # device, position and velocity in counts and counts/s, buttons
_COUNTS_PER_RAD = 4096 / (2 * math.pi)
_MAX_COUNTS = 32_767
_REPORT_HZ = 100  # reports of an encoder a second, until a program sets another frequency
_MAX_REPORT_HZ = 600

_DIRECTIONS = np.array([-1, -1, 1, 1, -1, -1])  # of the encoders, relative to the follower's joints
_TRIGGER = 6  # device of the trigger, whose reports also have the buttons
_TRIGGER_TRAVEL = -0.67  # rad, of a squeezed trigger, which closes the gripper
_RECORD_BUTTON = 0b10  # the second button, which starts and ends a recording

_ENGAGED_RAD = 0.1  # largest distance of a follower's joint from its leader's at which it follows
_ENGAGED_SECONDS = 1.0  # s, for which all followers must follow before the performance begins
_PRESS_SECONDS = 1.0  # s, of the button: many periods of a teleoperation loop on a slow machine
_PAUSE_SECONDS = 1.0  # s, of stillness between button and motion


class LeaderArms:
    """Leader arms that perform a motion once their followers follow.

    They hold the motion's first pose until all followers are held there. Then they press the record button, perform the
    motion, press the button again, and stay in its last pose. Times are simulation time.

    Args:
        served: the followers.
        motion: of six-joint arms; one per follower.
        buses: one per follower; the caller closes them.
    """

    def __init__(self, served: ServedArms, motion: RecordedMotion, buses: Sequence[UnixBus | KernelBus]) -> None:
        self._served, self._motion, self._buses = served, motion, tuple(buses)
        shape = len(self._buses), _TRIGGER + 1
        self._zero = np.zeros(shape)
        self._last = self._counts_at(0.0)
        self._due = np.zeros(shape)
        self._period = np.full(shape, 1 / _REPORT_HZ)
        self._engaged_since: float | None = None
        self._began: float | None = None

    @property
    def readers(self) -> Sequence[Any]:
        """Sockets to select for reading."""
        return [reader for bus in self._buses for reader in bus.readers]

    @property
    def writers(self) -> Sequence[Any]:
        """None: what a program does not read is lost, as on a CAN bus."""
        return []

    def handle(self, ready: set[Any]) -> None:
        """Execute requests to the encoders."""
        for k, bus in enumerate(self._buses):
            for frame in bus.receive(ready):
                if frame.id == _REQUEST_ID and len(frame.data) >= 2:
                    self._execute_request(k, frame.data)

    def flush(self) -> None:
        """Send the reports that are due."""
        now = self._served.motor_simulation.sim_time
        if now >= self._due.min():
            self._begin_if_engaged(now)
            self._send_reports(now)
        for bus in self._buses:
            bus.flush()

    def _execute_request(self, arm: int, data: bytes) -> None:
        for device in range(_TRIGGER + 1) if data[0] == _ALL_DEVICES else [data[0]]:
            if device > _TRIGGER:
                return
            if data[1] == _SET_ZERO:
                self._zero[arm, device] += self._last[arm, device]
                self._last[arm, device] = 0.0
            elif data[1] == _SET_FREQUENCY and len(data) > 2:
                frequency = min(int.from_bytes(data[2:4], "big"), _MAX_REPORT_HZ)
                self._period[arm, device] = 1 / frequency if frequency else math.inf
                self._due[arm, device] = self._served.motor_simulation.sim_time + self._period[arm, device]
            elif data[1] == _ASK_REPORT:
                self._due[arm, device] = 0.0

    def _begin_if_engaged(self, now: float) -> None:
        if self._began is not None:
            return
        if not self._is_engaged():
            self._engaged_since = None
        elif self._engaged_since is None:
            self._engaged_since = now
        elif now - self._engaged_since >= _ENGAGED_SECONDS:
            self._began = now

    def _is_engaged(self) -> bool:
        buses = self._served.motor_simulation.buses
        for follower, bus, arm in zip(self._served.followers, buses, self._motion.arms, strict=True):
            first = _commanded_joints(arm)[0]
            if np.abs(follower.joint_pos()[: len(first)] - first).max() > _ENGAGED_RAD:
                return False
            # A program that only compensates gravity, such as before it starts to follow, has no stiffness.
            if not all(motor.control_law()[0] > 0 for motor in bus.motors[: len(first)]):
                return False
        return True

    def _counts_at(self, time: float) -> Array:
        """Return the encoders' counts (arms, 7) at a time of the motion, s."""
        rows = []
        for arm, follower in zip(self._motion.arms, self._served.followers, strict=True):
            joints = [np.interp(time, self._motion.times, column) for column in _commanded_joints(arm).T]
            opening = _commanded_openings(arm)
            share = 1.0 if opening is None else np.interp(time, self._motion.times, opening) / follower.full_opening
            rows.append([*(_DIRECTIONS * joints), _TRIGGER_TRAVEL * (1 - min(max(share, 0.0), 1.0))])
        counts: Array = np.clip(np.round(np.array(rows) * _COUNTS_PER_RAD), -_MAX_COUNTS, _MAX_COUNTS) - self._zero
        return counts

    def _performance_at(self, now: float) -> tuple[float, int]:
        """Return the time of the motion, s, and the pressed buttons."""
        if self._began is None:
            return 0.0, 0
        passed = now - self._began
        time = min(max(passed - _PRESS_SECONDS - _PAUSE_SECONDS, 0.0), self._motion.duration)
        second = _PRESS_SECONDS + _PAUSE_SECONDS + self._motion.duration + _PAUSE_SECONDS
        pressed = passed < _PRESS_SECONDS or second <= passed < second + _PRESS_SECONDS
        return time, _RECORD_BUTTON if pressed else 0

    def _send_reports(self, now: float) -> None:
        time, buttons = self._performance_at(now)
        counts = self._counts_at(time)
        for arm, device in np.argwhere(self._due <= now):
            position = int(counts[arm, device])
            period = min(self._period[arm, device], 1.0)
            speed = int(np.clip((position - self._last[arm, device]) / period, -_MAX_COUNTS, _MAX_COUNTS))
            self._last[arm, device] = position
            self._due[arm, device] = now + self._period[arm, device]
            data = _REPORT.pack(device, position, speed, buttons if device == _TRIGGER else 0)
            self._buses[arm].send(CanFrame(_REPORT_ID, data))


def read_leader_motion(path: Path, rig: RigConfig, locations: Locations) -> RecordedMotion:
    """Return the motion that leaders perform.

    Args:
        path: an episode or a recording of any format of `yamsim import`.

    Raises:
        UsageError: the path has several episodes, or an arm of the rig has not six joints.
        DatasetError: the recording is missing, damaged, or does not fit the rig.
    """
    for arm in rig.arms:
        if arm.robot.dof != _TRIGGER:
            raise UsageError(
                f"--leader: leader arms have {_TRIGGER} joints, and arm {arm.name!r} of rig {rig.name!r} has "
                f"{arm.robot.dof}; give another --rig"
            )
    motions = read_motions([path], rig, locations)
    if len(motions) > 1:
        raise UsageError(f"--leader {path}: has {len(motions)} episodes; give one, such as {path}/ep_000000")
    return motions[0]


def leader_channels(served: ServedArms) -> Iterator[tuple[str, str]]:
    """Yield side and channel of each leader, in the order of the followers."""
    return zip(served.sides, LEADER_CHANNELS, strict=False)


def _commanded_joints(arm: ArmMotion) -> Array:
    return arm.joints if arm.commands is None else arm.commands


def _commanded_openings(arm: ArmMotion) -> Array | None:
    return arm.openings if arm.commanded_openings is None else arm.commanded_openings
