"""Arms on emulated motors hold, fall, press and jam by their frames and faults."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.errors import UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.real.motors.can_config import CanConfig, load_can_config
from yamsim_cli.real.motors.can_frames import MitCommand
from yamsim_cli.real.motors.motor import Motor, MotorStatus
from yamsim_cli.real.motors.motor_bus import BusFault
from yamsim_cli.real.serve.motor_simulation import MotorSimulation
from yamsim_cli.real.serve.served_arms import ServedArms, serve_arms

Serve = Callable[..., ServedArms]


@pytest.fixture(scope="module")
def serve(make_config: Callable[..., RecordConfig], locations: Locations) -> Serve:
    def made(rig: str = "yam_v1+linear_4310", **given: object) -> ServedArms:
        return serve_arms(Session(make_config({("rig",): rig}), locations), **given)  # type: ignore[arg-type]

    return made


def run(plant: MotorSimulation, seconds: float, tell: Callable[[], None] = lambda: None) -> None:
    for _ in range(round(seconds / plant.timestep)):
        tell()
        plant.step()


def positions(motors: tuple[Motor, ...]) -> np.ndarray:
    return np.array([motor.position for motor in motors])


def test_without_power_it_rests_on_its_stops_and_falls_from_elsewhere(serve: Serve) -> None:
    served = serve()
    run(served.motor_simulation, 2)
    assert np.abs(positions(served.motor_simulation.buses[0].motors)[:3]).max() < 0.01
    served = serve(start="home")
    before = positions(served.motor_simulation.buses[0].motors)
    run(served.motor_simulation, 1)
    assert np.abs(positions(served.motor_simulation.buses[0].motors) - before).max() > 0.5


def test_joints_with_load_zero_do_not_fall(
    make_config: Callable[..., RecordConfig], locations: Locations, monkeypatch: pytest.MonkeyPatch
) -> None:
    def weightless(*given: Any) -> CanConfig:
        found = load_can_config(*given)
        motors = tuple(motor.model_copy(update={"load": 0.0}) for motor in found.arm.motors)
        return replace(found, arm=found.arm.model_copy(update={"motors": motors}))

    monkeypatch.setattr("yamsim_cli.real.serve.served_arms.load_can_config", weightless)
    session = Session(make_config({("rig",): "yam_v1+linear_4310"}), locations)
    plant = serve_arms(session, start="home").motor_simulation
    before = positions(plant.buses[0].motors)
    run(plant, 1)
    assert np.abs(positions(plant.buses[0].motors) - before)[:6].max() < 0.01


def test_it_floats_on_the_torques_that_hold_it(serve: Serve) -> None:
    """With neither gains nor damping, only the joints' friction is left."""
    plant = serve(start="task").motor_simulation
    motors = plant.buses[0].motors
    before = positions(motors)

    def tell() -> None:
        for motor, torque in zip(motors, plant.gravity_torques(0), strict=True):
            motor.apply_command(MitCommand(0, 0, 0, 0, torque), plant.sim_time)

    run(plant, 2, tell)
    assert np.abs(positions(motors) - before)[:6].max() < 1e-3


def test_each_motor_follows_its_own_gains(serve: Serve) -> None:
    """A free joint is off by its load over its gain."""
    plant = serve(start="task").motor_simulation
    motors = plant.buses[0].motors
    start = positions(motors)

    def tell() -> None:
        for motor, position in zip(motors, start, strict=True):
            motor.apply_command(MitCommand(float(position), 0, 80.0, 2.0, 0), plant.sim_time)

    run(plant, 2, tell)
    held = np.array(plant.gravity_torques(0))[:6]
    sag = (positions(motors) - start)[:6]
    # Friction may carry a part of it.
    friction = np.array([0.3, 0.3, 0.3, 0.06, 0.06, 0.06])
    assert (np.abs(-80.0 * sag - held) <= friction + 0.02).all()
    assert motors[1].torque == pytest.approx(-80.0 * sag[1], abs=0.02)


def test_a_torque_finds_both_ends_of_the_gripper(serve: Serve) -> None:
    plant = serve().motor_simulation
    motor = plant.buses[0].motors[-1]
    ends = []
    for torque in (0.5, -0.5):
        run(plant, 1.0, lambda torque=torque: motor.apply_command(MitCommand(0, 0, 0, 0, torque), plant.sim_time))  # type: ignore[misc]
        ends.append(motor.position)
    # 95 mm of 96 mm, which are 6.57 rad; forwards closes.
    assert ends == pytest.approx([0.0, -6.5], abs=0.05)


def test_a_stuck_gripper_stays(serve: Serve) -> None:
    plant = serve(faults=[BusFault("stuck")]).motor_simulation
    motor = plant.buses[0].motors[-1]
    run(plant, 0.1)
    run(plant, 0.5, lambda: motor.apply_command(MitCommand(-6.0, 0, 20.0, 0.5, 0), plant.sim_time))
    assert abs(motor.position) < 0.05
    assert abs(motor.torque) == pytest.approx(10.0, abs=0.1)


def test_a_follower_goes_where_it_is_told_and_presses_no_harder_than_it_may(serve: Serve) -> None:
    served = serve(start="home")
    follower = served.followers[0]
    target = np.array([0.3, 1.2, 1.2, -0.2, 0.1, 0.2, 1.0])
    follower.command_joint_pos(target)
    run(served.motor_simulation, 3, follower.command_motors)
    assert follower.joint_pos() == pytest.approx(target, abs=0.01)
    follower.command_joint_pos(np.append(target[:6], 0.0))
    run(served.motor_simulation, 3, follower.command_motors)
    # Closed without an object: at the limit, with the manufacturer's force limit.
    assert follower.joint_pos()[-1] == pytest.approx(0.0, abs=0.01)
    assert abs(served.motor_simulation.buses[0].motors[-1].torque) < 1.05


@pytest.mark.parametrize(
    "told",
    [np.zeros(6), np.full(7, np.nan), [["a"]], "text", None, np.full((7, 2), 1.0)],
    ids=["six", "nan", "letters", "text", "none", "table"],
)
def test_a_follower_refuses_what_is_no_command(serve: Serve, told: object) -> None:
    follower = serve().followers[0]
    with pytest.raises(ValueError, match="joint_pos: "):
        follower.command_joint_pos(told)
    with pytest.raises(ValueError, match=r"pos"):
        follower.command_joint_state({"pos": told, "vel": np.zeros(7)})


def test_two_arms_are_on_two_buses(serve: Serve) -> None:
    served = serve("yam_station_linear_4310_d405", faults=[BusFault("lost", channel="can_right", motor=3)])
    assert served.sides == ("left", "right")
    assert [bus.channel for bus in served.motor_simulation.buses] == ["can_left", "can_right"]
    for follower in served.followers:
        follower.command_joint_pos(np.array([0.0, 0.5, 0.5, 0.0, 0.0, 0.0, 0.5]))

    def tell() -> None:
        for follower in served.followers:
            follower.command_motors()

    run(served.motor_simulation, 1.5, tell)
    left, right = served.followers
    assert left.joint_pos()[2] == pytest.approx(0.5, abs=0.01)
    assert right.joint_pos()[2] < 0.3
    assert served.motor_simulation.buses[0].motors[2].status is MotorStatus.ENABLED


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"channels": ["a", "b"]}, "give 1 different names"),
        ({"channels": ["a/b"]}, "up to 15 letters"),
        ({"faults": [BusFault("lost", motor=9)]}, "no motor 9; valid: 1, 2, 3, 4, 5, 6, 7"),
        ({"faults": [BusFault("stuck", channel="can9")]}, "no channel 'can9'; valid: can0"),
    ],
)
def test_unknown_channels_and_motors_are_refused_by_name(serve: Serve, given: dict[str, object], says: str) -> None:
    with pytest.raises(UsageError) as caught:
        serve(**given)
    assert says in str(caught.value)
