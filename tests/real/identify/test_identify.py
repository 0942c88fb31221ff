"""Parameters identified from arms with known parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.planted_arms import TrueParameters, drive
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.recorded_motion import ArmMotion, RecordedMotion
from yamsim_cli.core.robots.dynamics import JointDynamics, MeasuredArmDynamics
from yamsim_cli.real.identify import parameter_fit as fitting
from yamsim_cli.real.identify.estimates import ESTIMATE_NAMES, Estimate, estimate_parameters, interval_half_widths
from yamsim_cli.real.identify.excitation import generate_excitation
from yamsim_cli.real.identify.identification import check_logs_usable, dynamics_with_estimates, identify_arms
from yamsim_cli.real.identify.parameter_fit import FitParameter, all_parameters, fit_parameters
from yamsim_cli.real.identify.plant_model import ArmLog, LogSimulation, ParametricArm, PlantParameters

JOINTS = tuple(f"joint{k}" for k in range(1, 7))
WHERE = Locations.from_environment({})
RIG = load_config(RigConfig, "rigs", "single", WHERE)
ARM = RIG.arms[0]


def _planted(**changes: object) -> TrueParameters:
    plant = ParametricArm(ARM)
    base = TrueParameters(
        delay=0.0,
        friction=plant.model_values.friction,
        damping=np.zeros(6),
        armature=plant.model_values.armature,
        offset=np.zeros(6),
        gravity=np.ones(6),
        law="tanh",
        integrator="RK4",
    )
    return replace(base, **changes)  # type: ignore[arg-type]


def _waves(times: Array, rng: np.random.Generator, fastest: float) -> Array:
    pace, phase = rng.uniform(0.2, fastest, (3, 6)), rng.uniform(0, 6.3, (3, 6))
    return np.sin(2 * np.pi * pace[None] * times[:, None, None] + phase[None]).mean(axis=1)


def _commands(seconds: float) -> tuple[Array, Array]:
    times = np.arange(0, seconds, 0.01)
    waves = _waves(times, np.random.default_rng(1), 1.2)
    ramp = np.clip(times, 0, 1)[:, None]
    return times, np.array([0.0, 1.3, 1.4, -0.3, 0.0, 0.0]) + 0.6 * ramp * waves


def _some(plant: ParametricArm) -> list[FitParameter]:
    """A few of all parameters: the fit of all takes a minute."""
    kept = (("friction", 1), ("damping", 1), ("gravity", 1), ("offset", 1), ("creep", 1))
    return [each for each in all_parameters(plant) if each.joint is None or (each.name, each.joint) in kept]


def test_planted_values_are_found_of_one_joint_with_the_delay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fitting, "all_parameters", _some)
    monkeypatch.setattr(fitting, "FINE_TIMESTEP", 0.002)
    friction, damping, offset, gravity = (
        ParametricArm(ARM).model_values.friction.copy(),
        np.zeros(6),
        np.zeros(6),
        np.ones(6),
    )
    friction[1], damping[1], offset[1], gravity[1] = 0.18, 0.6, 0.01, 1.08
    planted = _planted(delay=0.023, friction=friction, damping=damping, offset=offset, gravity=gravity)
    motion = drive(ARM, planted, *_commands(8.0), np.random.default_rng(0))

    found = fit_parameters(ARM, [ArmLog.from_motion(motion, motion.arms[0])]).values

    assert found.delay == pytest.approx(0.023, abs=0.001)
    assert found.friction[1] == pytest.approx(0.18, rel=0.05)
    assert found.damping[1] == pytest.approx(0.6, rel=0.1)
    assert found.offset[1] == pytest.approx(0.01, abs=np.radians(0.1))
    assert found.gravity[1] == pytest.approx(1.08, abs=0.01)


@pytest.mark.slow
def test_poses_tell_an_offset_from_a_gravity_factor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fitting, "all_parameters", _some)
    moving, still = _commands(12.0), _commands(12.0)
    still[1][:] = still[1][0] + 0.02 * (still[1] - still[1][0])
    widths = []
    for times, commands in (moving, still):
        motion = drive(ARM, _planted(), times, commands, np.random.default_rng(0))
        fitted = fit_parameters(ARM, [ArmLog.from_motion(motion, motion.arms[0])])
        halves = dict(zip([each.name for each in fitted.parameters], interval_half_widths(fitted), strict=True))
        widths.append(halves["offset"])

    assert widths[0] < 0.1 * widths[1]


def test_a_simulated_log_is_followed_by_its_own_values() -> None:
    plant = ParametricArm(ARM)
    times, commands = _commands(12.0)
    log = ArmLog("log", times, commands, commands, None)
    read = LogSimulation(plant, log).simulate(plant.model_values, plain=True)

    again = LogSimulation(plant, replace(log, joints=read)).simulate(plant.model_values, plain=True)

    # It starts at the measured joints, which are the commanded ones.
    assert np.abs(again - read).max() < 1e-9


def test_finer_steps_change_little_and_late_commands_act_late() -> None:
    times, commands = _commands(3.0)
    log = ArmLog("log", times, commands, commands, None)
    coarse, fine = ParametricArm(ARM), ParametricArm(ARM, 0.0005)
    late = replace(coarse.model_values, delay=0.02)

    at_once, finer = (
        LogSimulation(coarse, log).simulate(coarse.model_values),
        LogSimulation(fine, log).simulate(fine.model_values),
    )
    later = LogSimulation(coarse, log).simulate(late)

    assert np.abs(at_once - finer).max() < 1e-3
    assert np.abs(later[52:] - at_once[50:-2]).max() < np.abs(later - at_once).max() / 5


def test_fingers_follow_the_log_and_are_closed_without_it() -> None:
    times, commands = _commands(2.0)
    fingers = ARM.robot.fingers
    assert fingers is not None
    opened, sparse = np.full(len(times), fingers.initial_opening), np.full(len(times), np.nan)
    sparse[::10] = fingers.initial_opening
    plant = ParametricArm(ARM)

    def followed(**seen: Array) -> Array:
        log = ArmLog.from_motion(
            motion := RecordedMotion("log.csv", times, (ArmMotion("", commands, commands, **seen),)), motion.arms[0]
        )
        return LogSimulation(plant, log).simulate(plant.model_values)

    told, measured, unknown = followed(commanded_openings=opened), followed(openings=sparse), followed()
    closed = followed(openings=np.full(len(times), fingers.range[0]))

    assert np.array_equal(told, measured)
    assert np.array_equal(unknown, closed)
    # The fingers' inertia is a tenth of the last joint's.
    assert np.abs(told - closed)[:, -1].max() > 1e-4


def test_a_revision_of_a_revision_keeps_parameters_that_no_log_determines() -> None:
    was = MeasuredArmDynamics(
        revision="first",
        base="i2rt_yam",
        joints={"joint2": JointDynamics(kp=35.0, damping=0.2)},
        command_delay_ms=12.0,
        sensor_delay_ms=4.0,
        encoder_step_rad=0.0004,
        tip_mass_g=80,
    )
    plant = ParametricArm(ARM.model_copy(update={"dynamics": was}))
    told = [
        Estimate(
            "" if each.joint is None else ARM.robot.joint_names[each.joint],
            ESTIMATE_NAMES[each.name],
            number,
            0,
            0,
            number,
            True,
        )
        for each in all_parameters(plant)
        if each.name in ESTIMATE_NAMES
        for number in [fitting.parameter_value(plant.model_values, each)]
    ]

    found = dynamics_with_estimates(plant, was, told)

    assert plant.model_values.delay == pytest.approx(0.016)
    assert (found.command_delay_ms, found.sensor_delay_ms) == (pytest.approx(16.0), 0.0)
    assert (found.tip_mass_g, found.encoder_step_rad) == (80, 0.0004)
    assert found.joint("joint2").kp == 35.0
    assert found.joint("joint2").damping == pytest.approx(0.2)


def test_intervals_are_wide_where_a_log_says_nothing() -> None:
    plant = ParametricArm(ARM)
    times, commands = _commands(5.0)
    log = ArmLog("log", times, commands, commands, None)
    joints = LogSimulation(plant, log).simulate(plant.model_values) + np.random.default_rng(0).normal(
        0, 1e-4, commands.shape
    )
    run = LogSimulation(plant, replace(log, joints=joints))
    problem_parameters = all_parameters(plant)
    errors = run.simulate(plant.model_values) - joints
    slopes = np.stack(
        [
            run.simulate(
                fitting.replace_value(
                    plant.model_values, each, fitting.parameter_value(plant.model_values, each) + each.scale
                )
            )
            - joints
            - errors
            for each in problem_parameters
        ],
        axis=-1,
    )
    fitted = fitting.FitResult(
        plant.model_values, problem_parameters, errors, slopes, np.full(6, 1e4), times, np.ones(6)
    )

    told = {(each.joint, each.name): each for each in estimate_parameters(plant, fitted)}

    # The first joint turns about the vertical, without gravity torque.
    assert not told["joint1", "gravity_factor"].is_determined
    assert told["joint1", "gravity_factor"].high - told["joint1", "gravity_factor"].low > 1
    assert told["joint2", "gravity_factor"].is_determined
    assert told["joint2", "gravity_factor"].high - told["joint2", "gravity_factor"].low < 0.05
    inside = [each.low <= each.model_value <= each.high for each in told.values()]
    assert all(inside)


def test_a_log_without_commands_and_one_in_degrees_are_refused() -> None:
    times, commands = _commands(12.0)

    def identified(arm: ArmMotion) -> None:
        identify_arms(RIG, [RecordedMotion("log.csv", times, (arm,))], [], "mine")

    with pytest.raises(DatasetError, match=r"log\.csv: has no commands"):
        identified(ArmMotion("", commands))
    with pytest.raises(DatasetError, match="degrees"):
        identified(ArmMotion("", np.degrees(commands), np.degrees(commands)))


def test_a_joint_that_stands_still_is_named() -> None:
    times, commands = _commands(12.0)
    commands[:, 4] = 0.2

    with pytest.raises(DatasetError, match="joint5 hardly moves"):
        identify_arms(RIG, [RecordedMotion("log.csv", times, (ArmMotion("", commands, commands),))], [], "mine")


@pytest.mark.slow
def test_an_arm_that_differs_is_identified_and_the_held_out_gap_falls() -> None:
    scene = load_config(SceneConfig, "scenes", "tabletop", WHERE)
    motion = generate_excitation(RIG, 0, scene, WHERE, 40.0, 0)
    plant = ParametricArm(ARM)
    rng = np.random.default_rng(2)
    planted = _planted(
        delay=0.021,
        friction=1.5 * plant.model_values.friction,
        damping=0.3 * plant.kv,
        offset=rng.uniform(-0.02, 0.02, 6),
    )

    found = identify_arms(RIG, [drive(ARM, planted, motion.times, motion.commands, rng)], [], "mine")[0]

    by = {(each.joint, each.name): each for each in found.estimates}
    assert by["", "delay_s"].value == pytest.approx(0.021, abs=0.002)
    for k, joint in enumerate(ARM.robot.joint_names):
        assert by[joint, "friction_nm"].value == pytest.approx(planted.friction[k], rel=0.05)
        assert by[joint, "damping_nms"].value == pytest.approx(planted.damping[k], rel=0.15)
        assert by[joint, "offset_rad"].value == pytest.approx(planted.offset[k], abs=np.radians(0.2))
    assert found.held_out_error.relative_reduction > 0.8
    assert found.dynamics == MeasuredArmDynamics.model_validate(found.dynamics.model_dump())
    assert isinstance(plant.model_values, PlantParameters)


def _swinging(seconds: float, seed: int = 0) -> tuple[Array, Array]:
    times = np.arange(0, seconds, 0.01)
    return times, 0.6 * _waves(times, np.random.default_rng(seed), 0.8)


def _log(times: Array, joints: Array) -> ArmLog:
    return ArmLog("log.csv", times, joints, joints, None)


@pytest.mark.parametrize("seed", range(20))
def test_a_joint_that_is_badly_excited_is_named_with_what_to_record(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    times, joints = _swinging(30.0, seed)
    joint, kind = int(rng.integers(6)), seed % 4
    noise = rng.normal(0, 2e-4, len(times))
    share = times / times[-1]
    joints[:, joint], fault, remedy = (
        (noise, "hardly moves", "swinging back and forth by 0.5 rad"),
        (0.8 * share + noise, "never turns back", "swinging back and forth at least 4 times"),
        (0.4 * np.sin(np.pi * share) + noise, "turns back only once", "at least 4 times"),
        (0.12 * np.sin(8 * np.pi * share) + noise, "is always slow", "faster swings"),
    )[kind]

    with pytest.raises(DatasetError) as caught:
        check_logs_usable([_log(times, joints)], JOINTS)

    assert f"joint{joint + 1} {fault}" in str(caught.value)
    assert remedy in str(caught.value)
    assert "yamsim excite" in str(caught.value)


def test_a_joint_that_only_others_shake_is_named() -> None:
    times, commands = _swinging(30.0)
    joints = commands.copy()
    commands[:, 3] = 0.3 * times / times[-1]
    joints[:, 3] = commands[:, 3] + 0.06 * np.sin(20 * times)

    with pytest.raises(DatasetError, match="joint4"):
        check_logs_usable([ArmLog("log.csv", times, commands, joints, None)], JOINTS)


@pytest.mark.parametrize("seed", range(5))
def test_a_log_in_which_all_joints_swing_is_taken(seed: int) -> None:
    check_logs_usable([_log(*_swinging(30.0, seed))], JOINTS)


def test_logs_complement_each_other() -> None:
    times, joints = _swinging(30.0)
    still = joints.copy()
    still[:, 2] = 0.0

    check_logs_usable([_log(times, still), _log(times, joints)], JOINTS)


def test_samples_without_joints_do_not_count() -> None:
    times, joints = _swinging(30.0)
    measured = joints.copy()
    measured[1::2] = np.nan

    check_logs_usable([ArmLog("log.csv", times, joints, measured, None)], JOINTS)


def test_a_short_log_is_refused() -> None:
    with pytest.raises(DatasetError, match=r"6\.0 s are too short; record at least 10 s"):
        check_logs_usable([_log(*_swinging(6.0))], JOINTS)


def test_the_error_for_one_of_two_arms_names_its_side() -> None:
    times, joints = _swinging(30.0)
    joints[:, 3] = 0.1

    with pytest.raises(DatasetError, match=r"left joint4 hardly moves"):
        check_logs_usable([_log(times, joints)], JOINTS, "left")
