"""Emulated motors: frames by their bytes, answers, bus faults, and wiring."""

from __future__ import annotations

import random
import struct
from dataclasses import replace
from pathlib import Path

import pytest

from yamsim_cli.core.errors import ConfigError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.real.motors import can_frames as frames
from yamsim_cli.real.motors.can_config import load_can_config
from yamsim_cli.real.motors.can_frames import CanFrame, MitCommand, MotorRange
from yamsim_cli.real.motors.motor import MOTOR_KINDS, Motor, MotorStatus
from yamsim_cli.real.motors.motor_bus import BusFault, MotorBus, parse_fault

ENABLE, DISABLE, ZERO, CLEAR = (b"\xff" * 7 + bytes([last]) for last in (0xFC, 0xFD, 0xFE, 0xFB))


@pytest.fixture
def motor() -> Motor:
    return Motor(4, MOTOR_KINDS["DM4310"])


def say(motor: Motor, data: bytes, now: float = 0.0, to: int = 4) -> CanFrame | None:
    return motor.answer_frame(CanFrame(to, data), now)


def status(answer: CanFrame | None) -> int:
    assert answer is not None
    return answer.data[0] >> 4


def register(what: int, number: int, value: bytes = bytes(4), motor: int = 4) -> bytes:
    return bytes([motor, 0, what, number]) + value


def mit(position: float, velocity: float, kp: float, kd: float, torque: float, scale: MotorRange) -> bytes:
    """A frame in the packing of the manufacturer's driver."""
    most = (*scale[:2], 250.0, 2.5, scale.torque)
    shifted = (position, velocity, kp - 250.0, kd - 2.5, torque)
    p, v, kp_bits, kd_bits, t = (
        frames.quantize(value, limit, bits)
        for value, limit, bits in zip(shifted, most, (16, 12, 12, 12, 12), strict=True)
    )
    return (p << 48 | v << 36 | kp_bits << 24 | kd_bits << 12 | t).to_bytes(8, "big")


def test_a_mit_frame_by_hand() -> None:
    """Full scale, nothing, and the middle of each field, byte by byte."""
    scale = MotorRange(12.5, 30.0, 10.0)
    assert frames.decode_mit_command(bytes.fromhex("fffffff000000fff"), scale) == MitCommand(12.5, 30.0, 0.0, 0.0, 10.0)
    assert frames.decode_mit_command(bytes.fromhex("0000000ffffff000"), scale) == MitCommand(
        -12.5, -30.0, 500.0, 5.0, -10.0
    )
    got = frames.decode_mit_command(bytes.fromhex("7fff7ff14719a7ff"), scale)
    assert got == pytest.approx(MitCommand(0, 0, 327 * 500 / 4095, 410 * 5 / 4095, 0), abs=0.01)


def test_feedback_by_hand() -> None:
    """Identifier and status in the first byte, then position, velocity and torque, temperatures of driver and rotor."""
    data = frames.feedback_bytes(0x17, 1, 12.5, -30.0, 0.0, (33.9, 300.0), MotorRange(12.5, 30.0, 10.0))
    assert data == bytes.fromhex("17ffff0007ff21ff")


def test_a_motor_acts_only_once_enabled(motor: Motor) -> None:
    command = mit(1.0, 0.0, 20.0, 0.5, 0.0, motor.kind.value_ranges)
    assert status(say(motor, command)) == MotorStatus.DISABLED
    assert motor.control_law() == (0, 0, 0)
    assert status(say(motor, ENABLE)) == MotorStatus.ENABLED
    assert motor.control_law() == (0, 0, 0)
    answer = say(motor, command)
    assert answer is not None and answer.id == 0x14
    kp, kd, constant = motor.control_law()
    assert (kp, kd, constant) == pytest.approx((20.0, 0.5, 20.0), abs=0.15)
    assert status(say(motor, DISABLE)) == MotorStatus.DISABLED
    assert motor.control_law() == (0, 0, 0)


def test_a_motor_fails_after_400_ms_without_frames(motor: Motor) -> None:
    say(motor, ENABLE, now=1.0)
    motor.advance(1.39, 0.39)
    assert motor.status is MotorStatus.ENABLED
    motor.advance(1.41, 0.02)
    assert motor.status is MotorStatus.LOST_COMMUNICATION
    # Enabling does not clear an error, and no command acts.
    assert status(say(motor, ENABLE, 2.0)) == MotorStatus.LOST_COMMUNICATION
    assert status(say(motor, CLEAR, 2.0)) == MotorStatus.DISABLED
    assert status(say(motor, ENABLE, 2.0)) == MotorStatus.ENABLED
    # 0 disables the timeout.
    say(motor, register(frames.WRITE, 9), to=frames.BROADCAST_ID)
    motor.advance(1e6, 0.01)
    assert motor.status is MotorStatus.ENABLED


def test_a_motor_warms_up_by_its_torque_and_fails_when_too_hot(motor: Motor) -> None:
    say(motor, register(frames.WRITE, 9), to=frames.BROADCAST_ID)
    say(motor, ENABLE)
    motor.torque = motor.kind.rated_torque
    for k in range(3000):
        motor.advance(k, 1.0)
    assert motor.status is MotorStatus.ENABLED and motor.celsius == pytest.approx(80, abs=0.1)
    motor.torque = 2 * motor.kind.rated_torque
    for k in range(300):
        motor.advance(3000 + k, 1.0)
    assert motor.status is MotorStatus.ROTOR_TOO_HOT


def test_set_zero_moves_the_zero_position(motor: Motor) -> None:
    motor.position = 2.0
    answer = say(motor, ZERO)
    assert answer is not None and int.from_bytes(answer.data[1:3], "big") == 0x7FFF
    say(motor, ENABLE)
    say(motor, mit(1.0, 0.0, 10.0, 0.0, 0.0, motor.kind.value_ranges))
    kp, _, constant = motor.control_law()
    # It pulls towards 1 rad from there.
    assert constant / kp == pytest.approx(3.0, abs=0.001)


def test_registers_are_read_written_and_kept(motor: Motor) -> None:
    gear = say(motor, register(frames.READ, 20), to=frames.BROADCAST_ID)
    assert gear == CanFrame(0x14, register(frames.READ, 20, struct.pack("<f", 10.0)))
    written = register(frames.WRITE, 9, struct.pack("<I", 1234))
    assert say(motor, written, to=frames.BROADCAST_ID) == CanFrame(0x14, written)
    motor.power_off()
    assert say(motor, register(frames.READ, 9), to=frames.BROADCAST_ID) is None
    motor.power_on()
    assert motor.registers[9] == 8000
    say(motor, written, to=frames.BROADCAST_ID)
    short = say(motor, register(frames.SAVE, 9), to=frames.BROADCAST_ID)
    assert short is not None and len(short.data) < 8
    motor.power_off()
    motor.power_on()
    assert motor.registers[9] == 1234


@pytest.mark.parametrize(
    ("number", "value"),
    [
        pytest.param(20, struct.pack("<f", 40.0), id="read-only"),
        pytest.param(21, struct.pack("<f", float("nan")), id="not-a-number"),
        pytest.param(23, struct.pack("<f", 0.0), id="no-range"),
        pytest.param(8, struct.pack("<I", 0x7FF), id="the-identifier-of-all"),
    ],
)
def test_invalid_values_of_registers_change_nothing(motor: Motor, number: int, value: bytes) -> None:
    before = motor.registers[number]
    say(motor, register(frames.WRITE, number, value), to=frames.BROADCAST_ID)
    assert motor.registers[number] == before
    assert status(say(motor, ENABLE)) == MotorStatus.ENABLED


def test_a_new_identifier_counts_at_once(motor: Motor) -> None:
    say(motor, register(frames.WRITE, 8, struct.pack("<I", 9)), to=frames.BROADCAST_ID)
    assert say(motor, ENABLE) is None
    assert status(say(motor, ENABLE, to=9)) == MotorStatus.ENABLED


def test_another_mode_than_mit_answers_no_command(motor: Motor) -> None:
    say(motor, ENABLE)
    say(motor, register(frames.WRITE, 10, struct.pack("<I", 3)), to=frames.BROADCAST_ID)
    assert say(motor, bytes(8)) is None
    assert status(say(motor, ENABLE)) == MotorStatus.ENABLED


def test_random_frames_do_no_harm() -> None:
    """Each answer is a frame, and each torque is finite."""
    draw = random.Random(3)
    motors = [Motor(k, MOTOR_KINDS["DM4340"]) for k in range(1, 8)]
    bus = MotorBus("can0", motors)
    for k in range(10_000):
        to = draw.choice([frames.BROADCAST_ID, draw.randrange(8), draw.randrange(0x800)])
        data = bytes(draw.randrange(9)) if k % 7 == 0 else draw.randbytes(draw.randrange(9))
        if to == frames.BROADCAST_ID and len(data) == 8 and k % 2:
            data = bytes([draw.randrange(1, 8), 0, draw.choice([0x33, 0x55, 0xAA, 0xCC])]) + data[3:]
        for answer in bus.send(CanFrame(to, data), k * 1e-3):
            assert 0 <= answer.id < 0x800 and len(answer.data) <= 8
        bus.advance_to(k * 1e-3)
    assert all(abs(value) < 1e9 for motor in motors for value in motor.control_law())


def test_a_lost_motor_is_silent_and_comes_back_disabled() -> None:
    bus = MotorBus("can0", [Motor(1, MOTOR_KINDS["DM4340"])], [BusFault("lost", motor=1, start_time=1.0, seconds=1.0)])
    assert bus.send(CanFrame(1, ENABLE), 0.5)
    bus.advance_to(1.0)
    assert bus.send(CanFrame(1, ENABLE), 1.1) == []
    bus.advance_to(2.0)
    assert bus.motors[0].status is MotorStatus.DISABLED
    assert bus.send(CanFrame(1, ENABLE), 2.1)


def test_a_hot_motor_fails() -> None:
    bus = MotorBus("can_left", [Motor(1, MOTOR_KINDS["DM4340"])], [BusFault("hot", channel="can_left", motor=1)])
    bus.send(CanFrame(1, ENABLE), 0.0)
    bus.advance_to(0.02)
    assert status(bus.send(CanFrame(1, ENABLE), 0.02)[0]) == MotorStatus.ROTOR_TOO_HOT


def test_as_many_frames_get_lost_as_the_fault_says() -> None:
    """In each direction; the same frames for the same seed."""

    def answered(seed: int) -> list[bool]:
        bus = MotorBus("can0", [Motor(1, MOTOR_KINDS["DM4340"])], [BusFault("drop", lost_frame_share=0.2)], seed)
        bus.advance_to(0.01)
        return [bool(bus.send(CanFrame(1, ENABLE), 0.01)) for _ in range(2000)]

    assert sum(answered(0)) / 2000 == pytest.approx(0.64, abs=0.03)
    assert answered(0) == answered(0) != answered(1)


def test_a_fault_by_its_flag() -> None:
    assert parse_fault("lost:motor=3,at=5,for=2,channel=can_left") == BusFault("lost", "can_left", 3, 5.0, 2.0)
    assert parse_fault("stuck") == BusFault("stuck")
    assert parse_fault("drop:share=0.5").lost_frame_share == 0.5


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("broken", "unknown fault 'broken'; valid: lost, hot, drop, stuck"),
        ("lost", "give a motor, as in lost:motor=3"),
        ("lost:motor=x", "motor 'x' is not valid; it must lie in 1..15"),
        ("lost:motor=1.5", "motor '1.5' is not valid"),
        ("drop:motor=1", "a drop fault has no 'motor'; valid: share, channel, at, for"),
        ("drop:share=2", "it must lie in 0..1"),
        ("drop:share=0.1,share=0.2", "share is given twice"),
    ],
)
def test_the_error_for_a_wrong_flag_names_valid_values(text: str, says: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_fault(text)
    assert says in str(caught.value)


@pytest.mark.parametrize("name", ["yam_v1", "yam_pro_v1", "yam_ultra_v1", "yam_ultra_v2", "big_yam_v1", "i2rt_yam"])
def test_every_arm_has_wiring(name: str, locations: Locations) -> None:
    wiring = load_can_config(name, "linear_4310", 6, locations)
    assert wiring.gripper is not None
    # 6.57 rad of the motor for 96 mm between the fingers, and forwards closes them.
    assert wiring.gripper.shaft_ratio == pytest.approx(-6.57 / 0.048)
    assert [motor.id for motor in wiring.arm.motors] == [1, 2, 3, 4, 5, 6]


def test_the_error_for_a_gripper_without_wiring_names_those_with_one(locations: Locations) -> None:
    with pytest.raises(ConfigError, match=r"linear_3507 has no can.yaml.*crank, crank_4310, finray"):
        load_can_config("yam_v1", "linear_3507", 6, locations)


def test_the_error_for_wrong_wiring_names_its_place(locations: Locations, tmp_path: Path) -> None:
    folder = tmp_path / "robot_models" / "yam_v1"
    folder.mkdir(parents=True)
    (folder / "can.yaml").write_text("motors:\n- {id: 1, kind: DM9999}\n")
    with pytest.raises(ConfigError, match=r"can.yaml:2.*unknown motor 'DM9999'; valid: DM3507, DM4310"):
        load_can_config("yam_v1", None, 6, replace(locations, data=(tmp_path, *locations.data)))
    (folder / "can.yaml").write_text("motors:\n- {id: 1, kind: DM4340}\n")
    with pytest.raises(ConfigError, match="has 1 motors, and yam_v1 has 6 joints"):
        load_can_config("yam_v1", None, 6, replace(locations, data=(tmp_path, *locations.data)))
