"""A motor's registers, as DAMIAO's manual numbers them."""

from __future__ import annotations

import math
import struct

from .kinds import MotorKind

# What the motor itself looks at.
OT_VALUE, MST_ID, ESC_ID, TIMEOUT, CTRL_MODE, GR, PMAX, VMAX, TMAX, XOUT = 2, 7, 8, 9, 10, 20, 21, 22, 23, 81
ROTOR_POSITION = 80
MIT_MODE = 1

# Registers that hold whole numbers; all others hold a float32. Source: DAMIAO's manual.
_WHOLE = frozenset({7, 8, 9, 10, 13, 14, 15, 16, 35, 36})
# Those that can be written. Source: the same.
_WRITABLE = frozenset({*range(11), *range(21, 36)})
# What a frame to all can name: such a number is not taken where 0 or an infinite one would make answers impossible.
_POSITIVE = frozenset({PMAX, VMAX, TMAX})
_LARGEST_ID = 0x7FE
# Of ours, so that whoever reads it sees at once that the motor is simulated: "SIM" in ASCII.
_VERSION = 0x53494D
# What the manual calls the factory's: protections (V, degrees Celsius, A), gains of loops that MIT mode does not use.
_FACTORY = {
    0: 15.0, 1: 0.0, OT_VALUE: 100.0, 3: 0.98, 4: 2.0, 5: -2.0, 6: 600.0, 11: 0.0, 12: 0.0, 13: _VERSION, 14: _VERSION,
    16: 14, 17: 0.0, 18: 0.0, 19: 0.0, 24: 1000.0, 25: 0.0, 26: 0.0, 27: 0.0, 28: 0.0, 29: 32.0, 30: 1.0, 31: 4.0,
    32: 0.0, 33: 0.0, 34: 0.0, 35: 4, 36: 0, 50: 0.0, 51: 0.0, 52: 0.0, 53: 0.0, 54: 0.0, 55: 1.0,
}  # fmt: skip
# 400 ms in units of 50 us. Source: the maker's SDK 1.3.6, its README and `motor_config_tool/set_timeout.py`.
_FACTORY_TIMEOUT = 8000
TIMEOUT_UNIT = 50e-6


class Registers:
    """Register -> value, as the motor runs with them, and as they are after its power comes back.

    Args:
        kind: of the motor.
        motor: its CAN identifier; it answers with 16 more.
    """

    def __init__(self, kind: MotorKind, motor: int) -> None:
        own = {MST_ID: motor + 16, ESC_ID: motor, TIMEOUT: _FACTORY_TIMEOUT, CTRL_MODE: MIT_MODE, GR: kind.gear}
        scale = {PMAX: kind.scale.position, VMAX: kind.scale.velocity, TMAX: kind.scale.torque}
        self._saved: dict[int, float] = {**_FACTORY, 15: motor, ROTOR_POSITION: 0.0, XOUT: 0.0, **own, **scale}
        self._values = dict(self._saved)

    def __getitem__(self, register: int) -> float:
        return self._values[register]

    def show(self, register: int, value: float) -> None:
        """Let a register that only reports report a value."""
        self._values[register] = value

    def read(self, register: int) -> bytes | None:
        """Its four bytes; None if there is no such register."""
        value = self._values.get(register)
        if value is None:
            return None
        return struct.pack("<I", int(value)) if register in _WHOLE else struct.pack("<f", value)

    def write(self, register: int, data: bytes) -> bytes | None:
        """Set it from four bytes, and read it back; what it cannot take leaves it as it was."""
        if register in _WRITABLE:
            value = float(struct.unpack("<I" if register in _WHOLE else "<f", data)[0])
            if self._takes(register, value):
                self._values[register] = value
        return self.read(register)

    def save(self, register: int) -> bool:
        """Keep a register's value for when the power comes back; False if it cannot be kept."""
        if register not in _WRITABLE:
            return False
        self._saved[register] = self._values[register]
        return True

    def restart(self) -> None:
        """Power off and on: what was written and not saved is gone."""
        self._values = dict(self._saved)

    def _takes(self, register: int, value: float) -> bool:
        if not math.isfinite(value):
            return False
        if register in _POSITIVE:
            return 1e-3 <= value <= 1e6
        if register in (ESC_ID, MST_ID):
            return 0 < value <= _LARGEST_ID
        return True
