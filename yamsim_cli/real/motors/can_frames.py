"""Encode and decode CAN frames of DAMIAO motors."""

from __future__ import annotations

import struct
from typing import NamedTuple

# Linux `struct can_frame`: identifier with flags, length, three bytes of padding, data. yamsim's sockets use it too.
_CAN_FRAME = struct.Struct("=IB3x8s")
FRAME_BYTES = _CAN_FRAME.size
_FLAGS = 0xE0000000  # flag bits of extended, remote and error frames, which motors ignore
_MAX_DATA_BYTES = 8  # largest number of data bytes in a CAN frame

TO_ALL = 0x7FF  # identifier of register and status frames, which all motors receive; the data names one motor
# Last byte of a special command; its other seven bytes are 0xFF. Source: DAMIAO's DM-J43 manual, "MIT mode".
CLEAR_ERROR, ENABLE, DISABLE, SET_ZERO = 0xFB, 0xFC, 0xFD, 0xFE
# Third byte of a frame to TO_ALL: access to a register, or request of the status. Source: DAMIAO's DM-J43 manual.
READ, WRITE, SAVE, REFRESH = 0x33, 0x55, 0xAA, 0xCC
# Largest gains kp and kd in a MIT frame, N m/rad and N m s/rad, of all emulated motors. Source: DAMIAO's DM-J43 manual.
KP_MAX, KD_MAX = 500.0, 5.0


class CanFrame(NamedTuple):
    """A CAN frame: an 11-bit identifier and up to 8 bytes of data."""

    id: int
    data: bytes


class MitCommand(NamedTuple):
    """Command in a motor's MIT mode. At position p and velocity v, the motor gives the following torque.

    The torque is `kp (position - p) + kd (velocity - v) + torque`, in rad, rad/s and N m.
    """

    position: float
    velocity: float
    kp: float
    kd: float
    torque: float


class MotorRange(NamedTuple):
    """Largest position (rad), velocity (rad/s) and torque (N m) in a motor's frames: its PMAX, VMAX and TMAX."""

    position: float
    velocity: float
    torque: float


def parse_frame(wire: bytes) -> CanFrame | None:
    """Decode the 16 bytes of a frame from a socket. Return None for a frame that motors ignore."""
    identifier, length, data = _CAN_FRAME.unpack(wire)
    if identifier & _FLAGS or identifier > TO_ALL or length > _MAX_DATA_BYTES:
        return None
    return CanFrame(identifier, data[:length])


def to_wire(frame: CanFrame) -> bytes:
    """Encode a frame as the 16 bytes that are sent on a socket."""
    return _CAN_FRAME.pack(frame.id, len(frame.data), frame.data)


def special_command(data: bytes) -> int | None:
    """Return ENABLE, DISABLE, SET_ZERO or CLEAR_ERROR, or None if the data is no special command."""
    if len(data) == _MAX_DATA_BYTES and data[:7] == b"\xff" * 7 and CLEAR_ERROR <= data[7] <= SET_ZERO:
        return data[7]
    return None


def quantize(value: float, maximum: float, bits: int) -> int:
    """Clip a value to -maximum..maximum and return it as an unsigned number of `bits` bits."""
    return int((min(max(value, -maximum), maximum) + maximum) * ((1 << bits) - 1) / (2 * maximum))


def dequantize(number: int, maximum: float, bits: int) -> float:
    """Return the value of a quantized number: the inverse of `quantize`, to within one quantization step."""
    return number * 2 * maximum / ((1 << bits) - 1) - maximum


def read_mit(data: bytes, scale: MotorRange) -> MitCommand:
    """Decode the 8 data bytes of a frame in MIT mode. `scale` has the ranges of the motor."""
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
    """Return the 8 data bytes of a motor's feedback frame.

    Args:
        motor: identifier of the motor; the frame has its lowest four bits.
        status: 0 for disabled, 1 for enabled, 8 and more for an error.
        position, velocity, torque: state of the shaft, rad, rad/s and N m.
        celsius: temperatures of the driver and of the rotor, degrees Celsius.
    """
    bits = (status & 0xF) << 4 | motor & 0xF
    bits = bits << 16 | quantize(position, scale.position, 16)
    bits = bits << 12 | quantize(velocity, scale.velocity, 12)
    bits = bits << 12 | quantize(torque, scale.torque, 12)
    for degrees in celsius:
        bits = bits << 8 | min(max(int(degrees), 0), 255)
    return bits.to_bytes(8, "big")
