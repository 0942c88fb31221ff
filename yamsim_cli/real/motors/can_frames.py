"""Encode and decode CAN frames of DAMIAO motors."""

from __future__ import annotations

import struct
from typing import NamedTuple

# Linux `struct can_frame`: identifier with flags, length, three bytes of padding, data.
_CAN_FRAME = struct.Struct("=IB3x8s")
FRAME_BYTES = _CAN_FRAME.size
_IGNORED_ID_FLAGS = 0xE0000000  # extended, remote and error frames, which motors ignore
_MAX_DATA_BYTES = 8

BROADCAST_ID = 0x7FF  # register and status frames, which all motors receive; the data names one motor
# Last byte of a special command, after seven bytes 0xFF. Source: DAMIAO's DM-J43 manual, "MIT mode".
CLEAR_ERROR, ENABLE, DISABLE, SET_ZERO = 0xFB, 0xFC, 0xFD, 0xFE
# Third byte of a frame to BROADCAST_ID: register access or status request. Source: DAMIAO's DM-J43 manual.
READ, WRITE, SAVE, REFRESH = 0x33, 0x55, 0xAA, 0xCC
# N m/rad and N m s/rad, in MIT frames of all emulated motors. Source: DAMIAO's DM-J43 manual.
KP_MAX, KD_MAX = 500.0, 5.0


class CanFrame(NamedTuple):
    """An 11-bit identifier and up to 8 bytes of data."""

    id: int
    data: bytes


class MitCommand(NamedTuple):
    """MIT mode command: at position p and velocity v, rad and rad/s, a motor gives a torque, N m.

    It is `kp (position - p) + kd (velocity - v) + torque`.
    """

    position: float
    velocity: float
    kp: float
    kd: float
    torque: float


class MotorRange(NamedTuple):
    """Largest position (rad), velocity (rad/s) and torque (N m) in a motor's frames: PMAX, VMAX, TMAX."""

    position: float
    velocity: float
    torque: float


def parse_frame(wire: bytes) -> CanFrame | None:
    """Decode 16 bytes; None for a frame that motors ignore."""
    identifier, length, data = _CAN_FRAME.unpack(wire)
    if identifier & _IGNORED_ID_FLAGS or identifier > BROADCAST_ID or length > _MAX_DATA_BYTES:
        return None
    return CanFrame(identifier, data[:length])


def encode_frame(frame: CanFrame) -> bytes:
    """Encode as 16 bytes."""
    return _CAN_FRAME.pack(frame.id, len(frame.data), frame.data)


def special_command(data: bytes) -> int | None:
    """Return ENABLE, DISABLE, SET_ZERO or CLEAR_ERROR; None for other data."""
    if len(data) == _MAX_DATA_BYTES and data[:7] == b"\xff" * 7 and CLEAR_ERROR <= data[7] <= SET_ZERO:
        return data[7]
    return None


def quantize(value: float, maximum: float, bits: int) -> int:
    """Clip a value to -maximum..maximum, as an unsigned number of `bits` bits."""
    return int((min(max(value, -maximum), maximum) + maximum) * ((1 << bits) - 1) / (2 * maximum))


def dequantize(number: int, maximum: float, bits: int) -> float:
    """Invert `quantize`, to within one step."""
    return number * 2 * maximum / ((1 << bits) - 1) - maximum


def decode_mit_command(data: bytes, scale: MotorRange) -> MitCommand:
    """Decode a MIT frame's 8 bytes by the motor's ranges."""
    bits = int.from_bytes(data, "big")
    return MitCommand(
        position=dequantize(bits >> 48, scale.position, 16),
        velocity=dequantize(bits >> 36 & 0xFFF, scale.velocity, 12),
        kp=(bits >> 24 & 0xFFF) * KP_MAX / 0xFFF,
        kd=(bits >> 12 & 0xFFF) * KD_MAX / 0xFFF,
        torque=dequantize(bits & 0xFFF, scale.torque, 12),
    )


def feedback_bytes(
    motor: int,
    status: int,
    position: float,
    velocity: float,
    torque: float,
    celsius: tuple[float, float],
    scale: MotorRange,
) -> bytes:
    """Return a feedback frame's 8 bytes.

    Args:
        motor: identifier; the frame has its lowest four bits.
        status: 0 disabled, 1 enabled, 8 and more an error.
        position, velocity, torque: of the shaft, rad, rad/s and N m.
        celsius: of driver and rotor.
    """
    bits = (status & 0xF) << 4 | motor & 0xF
    bits = bits << 16 | quantize(position, scale.position, 16)
    bits = bits << 12 | quantize(velocity, scale.velocity, 12)
    bits = bits << 12 | quantize(torque, scale.torque, 12)
    for degrees in celsius:
        bits = bits << 8 | min(max(int(degrees), 0), 255)
    return bits.to_bytes(8, "big")
