"""Emulated DAMIAO motors: kinds, registers, answers to CAN frames, control law."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import IntEnum

from . import can_frames as frames
from .can_frames import CanFrame, MitCommand, MotorRange

AMBIENT_CELSIUS = 25.0  # degrees Celsius, around a motor
# K, steady rise of a rotor at rated torque. At the default limit of 100 degrees Celsius, it gives rated torque without
# limit, and 1.2 times that for minutes. An assumption: no figures are published.
_RATED_TEMPERATURE_RISE = 55.0
_THERMAL_TIME_CONSTANT = 300.0  # s, time constant of the rotor. An assumption: no figure is published
_DRIVER_RISE_SHARE = 0.5  # driver's temperature rise over the rotor's. An assumption
# Degrees Celsius; a register has the rotor's limit. Source: DAMIAO's DM-J43 manual, "protections".
_MAX_DRIVER_CELSIUS = 120.0
_ZERO_COMMAND = MitCommand(0.0, 0.0, 0.0, 0.0, 0.0)

# Registers that affect the emulated motor. Source: DAMIAO's manual.
OT_VALUE, MST_ID, ESC_ID, TIMEOUT, CTRL_MODE, GR, PMAX, VMAX, TMAX, XOUT = 2, 7, 8, 9, 10, 20, 21, 22, 23, 81
ROTOR_POSITION = 80  # rotor angle before the gear, rad
MIT_MODE = 1  # CTRL_MODE that executes a `MitCommand`

# All other registers hold a float32. Source: DAMIAO's manual.
_INTEGER_REGISTERS = frozenset({7, 8, 9, 10, 13, 14, 15, 16, 35, 36})
# Source: DAMIAO's manual.
_WRITABLE_REGISTERS = frozenset({*range(11), *range(21, 36)})
_POSITIVE_REGISTERS = frozenset({PMAX, VMAX, TMAX})  # positive and finite: `quantize` divides by them
_MAX_MOTOR_ID = 0x7FE
_FIRMWARE_VERSION = 0x53494D  # "SIM" in ASCII: identifies a simulated motor
# Register -> factory value: protections (V, degrees Celsius, A), gains of loops that MIT mode does not use.
_FACTORY_VALUES = {
    0: 15.0, 1: 0.0, OT_VALUE: 100.0, 3: 0.98, 4: 2.0, 5: -2.0, 6: 600.0, 11: 0.0, 12: 0.0, 13: _FIRMWARE_VERSION,
    14: _FIRMWARE_VERSION,
    16: 14, 17: 0.0, 18: 0.0, 19: 0.0, 24: 1000.0, 25: 0.0, 26: 0.0, 27: 0.0, 28: 0.0, 29: 32.0, 30: 1.0, 31: 4.0,
    32: 0.0, 33: 0.0, 34: 0.0, 35: 4, 36: 0, 50: 0.0, 51: 0.0, 52: 0.0, 53: 0.0, 54: 0.0, 55: 1.0,
}  # fmt: skip
# 400 ms. Source: the maker's SDK 1.3.6, README and `motor_config_tool/set_timeout.py`
_FACTORY_TIMEOUT = 8000
_TIMEOUT_UNIT = 50e-6  # s per unit of TIMEOUT


@dataclass(frozen=True)
class MotorKind:
    """A DAMIAO motor type.

    Attributes:
        name: in the maker's SDK.
        value_ranges: of values in frames. Source: `motor_drivers/utils.py` in the maker's SDK 1.3.6.
        gear_ratio: by which programs identify the type. Source: the same file.
        rated_torque: continuous torque, N m. Source: DAMIAO's tables.
    """

    name: str
    value_ranges: MotorRange
    gear_ratio: float
    rated_torque: float

    @property
    def rise_per_squared_torque(self) -> float:
        """Final temperature rise of the rotor per squared torque, K/(N m)2."""
        return _RATED_TEMPERATURE_RISE / self.rated_torque**2


MOTOR_KINDS = {
    kind.name: kind
    for kind in (
        MotorKind("DM3507", MotorRange(12.5, 50.0, 5.0), 7.0, 1.2),
        MotorKind("DM4310", MotorRange(12.5, 30.0, 10.0), 10.0, 3.0),
        MotorKind("DM4340", MotorRange(12.5, 10.0, 28.0), 40.0, 9.0),
        MotorKind("DM6248", MotorRange(12.5, 20.0, 120.0), 48.0, 35.0),
    )
}


class Registers:
    """A motor's registers, current and saved; a motor answers with identifier `motor + 16`."""

    def __init__(self, kind: MotorKind, motor: int) -> None:
        own = {MST_ID: motor + 16, ESC_ID: motor, TIMEOUT: _FACTORY_TIMEOUT, CTRL_MODE: MIT_MODE, GR: kind.gear_ratio}
        scale = {PMAX: kind.value_ranges.position, VMAX: kind.value_ranges.velocity, TMAX: kind.value_ranges.torque}
        self._saved: dict[int, float] = {**_FACTORY_VALUES, 15: motor, ROTOR_POSITION: 0.0, XOUT: 0.0, **own, **scale}
        self._values = dict(self._saved)

    def __getitem__(self, register: int) -> float:
        return self._values[register]

    def set_reported(self, register: int, value: float) -> None:
        """Set a read-only register."""
        self._values[register] = value

    def read(self, register: int) -> bytes | None:
        """Return a register's four bytes; None if unknown."""
        value = self._values.get(register)
        if value is None:
            return None
        return struct.pack("<I", int(value)) if register in _INTEGER_REGISTERS else struct.pack("<f", value)

    def write(self, register: int, data: bytes) -> bytes | None:
        """Write four bytes and return the register's; invalid values are ignored."""
        if register in _WRITABLE_REGISTERS:
            value = float(struct.unpack("<I" if register in _INTEGER_REGISTERS else "<f", data)[0])
            if self._is_valid(register, value):
                self._values[register] = value
        return self.read(register)

    def save(self, register: int) -> bool:
        """Keep a value across restarts; False if it cannot be saved."""
        if register not in _WRITABLE_REGISTERS:
            return False
        self._saved[register] = self._values[register]
        return True

    def restart(self) -> None:
        """Restore saved values, as a power cycle does."""
        self._values = dict(self._saved)

    def _is_valid(self, register: int, value: float) -> bool:
        if not math.isfinite(value):
            return False
        if register in _POSITIVE_REGISTERS:
            return 1e-3 <= value <= 1e6
        if register in (ESC_ID, MST_ID):
            return 0 < value <= _MAX_MOTOR_ID
        return True


class MotorStatus(IntEnum):
    """A motor's status in each answer. Source: DAMIAO's manual, "feedback frame"."""

    DISABLED = 0x0
    ENABLED = 0x1
    DRIVER_TOO_HOT = 0xB
    ROTOR_TOO_HOT = 0xC
    LOST_COMMUNICATION = 0xD


class Motor:
    """A motor without physics and sockets; positions are the output shaft's.

    Attributes:
        number: initial CAN identifier, by which faults name the motor.
        position, velocity, torque: of the shaft, set by the simulation, rad, rad/s and N m.
        celsius: of the rotor.
        is_unplugged: a lost motor ignores frames and gives no torque.
        control_law_changed: since a caller last cleared this flag.
    """

    def __init__(self, number: int, kind: MotorKind) -> None:
        self.number = number
        self.kind = kind
        self.registers = Registers(kind, number)
        self.status = MotorStatus.DISABLED
        self.position = self.velocity = self.torque = 0.0
        self.celsius = AMBIENT_CELSIUS
        self.is_unplugged = False
        self.control_law_changed = True
        self._command = _ZERO_COMMAND
        self._zero = 0.0
        self._last_frame_time = 0.0
        self._scale = kind.value_ranges

    @property
    def command_id(self) -> int:
        """Identifier of frames to this motor."""
        return int(self.registers[ESC_ID])

    @property
    def max_torque(self) -> float:
        """Largest torque, N m: the smaller of TMAX and its kind's limit."""
        return min(self._scale.torque, self.kind.value_ranges.torque)

    @property
    def driver_celsius(self) -> float:
        """Temperature of the driver's transistors."""
        return AMBIENT_CELSIUS + _DRIVER_RISE_SHARE * (self.celsius - AMBIENT_CELSIUS)

    def control_law(self) -> tuple[float, float, float]:
        """Return (kp, kd, constant): the torque is `constant - kp position - kd velocity`, N m, up to `max_torque`."""
        if self.status is not MotorStatus.ENABLED or self.is_unplugged:
            return 0.0, 0.0, 0.0
        command = self._command
        constant = command.kp * (command.position + self._zero) + command.kd * command.velocity + command.torque
        return command.kp, command.kd, constant

    def answer_frame(self, frame: CanFrame, now: float) -> CanFrame | None:
        """Return the answer to a frame at time `now`, s, if any."""
        if self.is_unplugged:
            return None
        if frame.id == frames.BROADCAST_ID:
            return self._handle_register_frame(frame.data)
        if frame.id != self.command_id or len(frame.data) != 8:
            return None
        order = frames.special_command(frame.data)
        if order is None:
            if self.registers[CTRL_MODE] != MIT_MODE:
                return None
            # A motor that is not enabled answers but does not execute.
            self._command = (
                frames.decode_mit_command(frame.data, self._scale)
                if self.status is MotorStatus.ENABLED
                else _ZERO_COMMAND
            )
        else:
            self._handle_special(order)
        self._last_frame_time = now
        self.control_law_changed = True
        return self._feedback_frame()

    def apply_command(self, command: MitCommand, now: float) -> None:
        """Enable a disabled motor and apply a command at time `now`, s, unless it is in an error state.

        Positions disregard a zero set by SET_ZERO.
        """
        if self.is_unplugged:
            return
        if self.status is MotorStatus.DISABLED:
            self.status = MotorStatus.ENABLED
        if self.status is MotorStatus.ENABLED:
            self._command = command._replace(position=command.position - self._zero)
        self._last_frame_time = now
        self.control_law_changed = True

    def advance(self, now: float, seconds: float) -> None:
        """Advance by `seconds` to `now`, s: heat up, and enter an error state if too hot or past the timeout."""
        rise = self.kind.rise_per_squared_torque * self.torque**2
        self.celsius += (AMBIENT_CELSIUS + rise - self.celsius) * min(1.0, seconds / _THERMAL_TIME_CONSTANT)
        if self.status is not MotorStatus.ENABLED:
            return
        timeout = self.registers[TIMEOUT] * _TIMEOUT_UNIT
        if self.celsius > self.registers[OT_VALUE]:
            self._enter_error_state(MotorStatus.ROTOR_TOO_HOT)
        elif self.driver_celsius > _MAX_DRIVER_CELSIUS:
            self._enter_error_state(MotorStatus.DRIVER_TOO_HOT)
        elif timeout and now - self._last_frame_time > timeout:
            self._enter_error_state(MotorStatus.LOST_COMMUNICATION)

    def power_off(self) -> None:
        """Unplug the motor."""
        self.is_unplugged = True
        self.control_law_changed = True

    def power_on(self) -> None:
        """Restore power: the motor is disabled, with saved registers."""
        self.is_unplugged = False
        self.registers.restart()
        self._update_range()
        self.status, self._command = MotorStatus.DISABLED, _ZERO_COMMAND
        self.control_law_changed = True

    def _enter_error_state(self, status: MotorStatus) -> None:
        self.status, self._command = status, _ZERO_COMMAND
        self.control_law_changed = True

    def _handle_special(self, order: int) -> None:
        if order == frames.ENABLE:
            if self.status is MotorStatus.DISABLED:
                self.status, self._command = MotorStatus.ENABLED, _ZERO_COMMAND
        elif order == frames.SET_ZERO:
            self._zero = self.position
        elif order == frames.DISABLE:
            self._command = _ZERO_COMMAND
            if self.status is MotorStatus.ENABLED:
                self.status = MotorStatus.DISABLED
        elif self.status is not MotorStatus.ENABLED:
            self.status = MotorStatus.DISABLED

    def _feedback_frame(self) -> CanFrame:
        celsius = self.driver_celsius, self.celsius
        state = self.position - self._zero, self.velocity, self.torque
        data = frames.feedback_bytes(self.command_id, self.status, *state, celsius, self._scale)
        return CanFrame(int(self.registers[MST_ID]), data)

    def _handle_register_frame(self, data: bytes) -> CanFrame | None:
        if len(data) < 4 or int.from_bytes(data[:2], "little") != self.command_id:
            return None
        access, register = data[2], data[3]
        if access == frames.REFRESH:
            return self._feedback_frame()
        self.registers.set_reported(XOUT, self.position - self._zero)
        self.registers.set_reported(ROTOR_POSITION, (self.position - self._zero) * self.kind.gear_ratio)
        if access == frames.READ:
            value = self.registers.read(register)
        elif access == frames.WRITE and len(data) == 8:
            value = self.registers.write(register, data[4:8])
            self._update_range()
        elif access == frames.SAVE:
            # An enabled motor does not save. The answer is a short frame.
            saved = self.status is not MotorStatus.ENABLED and self.registers.save(register)
            return self._register_answer(bytes([frames.SAVE, saved]))
        else:
            return None
        return None if value is None else self._register_answer(bytes([access, register]) + value)

    def _register_answer(self, content: bytes) -> CanFrame:
        # A new identifier applies immediately.
        return CanFrame(int(self.registers[MST_ID]), self.command_id.to_bytes(2, "little") + content)

    def _update_range(self) -> None:
        known = self.registers
        self._scale = MotorRange(known[PMAX], known[VMAX], known[TMAX])
