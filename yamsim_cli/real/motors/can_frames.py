"""CAN frames of DAMIAO motors, as bytes."""

from __future__ import annotations

import struct
from typing import NamedTuple

# Linux' `struct can_frame`: identifier with flags, length, three bytes of padding, data. yamsim's sockets carry it too.
_CAN_FRAME = struct.Struct("=IB3x8s")
FRAME_BYTES = _CAN_FRAME.size
_FLAGS = 0xE0000000  # of extended, remote and error frames, which motors ignore
_LONGEST = 8

TO_ALL = 0x7FF  # identifier of frames to all motors; the data names one motor
# Last byte of a frame whose other seven are 0xFF. Source: DAMIAO's manual of the DM-J43 series, "MIT mode".
CLEAR_ERROR, ENABLE, DISABLE, SET_ZERO = 0xFB, 0xFC, 0xFD, 0xFE
# Third byte of a frame to all. Source: the same manual.
READ, WRITE, SAVE, REFRESH = 0x33, 0x55, 0xAA, 0xCC
# Ranges of gains in a MIT frame, the same in all of these motors. Source: the same manual.
KP_MAX, KD_MAX = 500.0, 5.0


class CanFrame(NamedTuple):
    """A CAN frame: an identifier of 11 bits, and up to 8 bytes of data."""

    id: int
    data: bytes


class MitCommand(NamedTuple):
    """The command of a MIT frame at the motor's shaft: torque `kp (position - p) + kd (velocity - v) + torque`."""

    position: float
    velocity: float
    kp: float
    kd: float
    torque: float


class MotorRange(NamedTuple):
    """The largest position (rad), velocity (rad/s) and torque (N m) in a motor's frames: its PMAX, VMAX and TMAX."""

    position: float
    velocity: float
    torque: float


def parse_frame(wire: bytes) -> CanFrame | None:
    """The frame in 16 bytes of a socket; None for frames that motors ignore."""
    identifier, length, data = _CAN_FRAME.unpack(wire)
    if identifier & _FLAGS or identifier > TO_ALL or length > _LONGEST:
        return None
    return CanFrame(identifier, data[:length])


def to_wire(frame: CanFrame) -> bytes:
    """A frame's 16 bytes on a socket."""
    return _CAN_FRAME.pack(frame.id, len(frame.data), frame.data)


def special_command(data: bytes) -> int | None:
    """ENABLE, DISABLE, SET_ZERO or CLEAR_ERROR; None for any other frame."""
    if len(data) == _LONGEST and data[:7] == b"\xff" * 7 and CLEAR_ERROR <= data[7] <= SET_ZERO:
        return data[7]
    return None


def quantize(value: float, maximum: float, bits: int) -> int:
    """A value, clipped to -most..most, as an unsigned number of `bits` bits."""
    return int((min(max(value, -maximum), maximum) + maximum) * ((1 << bits) - 1) / (2 * maximum))


def dequantize(number: int, maximum: float, bits: int) -> float:
    """The inverse of `quantize`, to within a step."""
    return number * 2 * maximum / ((1 << bits) - 1) - maximum


def read_mit(data: bytes, scale: MotorRange) -> MitCommand:
    """The command in the 8 bytes of a MIT frame."""
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
    """The 8 bytes of an answer.

    Args:
        motor: its identifier, of which the answer has the lowest four bits.
        status: 0 disabled, 1 enabled, from 8 on an error.
        celsius: temperatures of the driver and of the rotor.
    """
    bits = (status & 0xF) << 4 | motor & 0xF
    bits = bits << 16 | quantize(position, scale.position, 16)
    bits = bits << 12 | quantize(velocity, scale.velocity, 12)
    bits = bits << 12 | quantize(torque, scale.torque, 12)
    for degrees in celsius:
        bits = bits << 8 | min(max(int(degrees), 0), 255)
    return bits.to_bytes(8, "big")
