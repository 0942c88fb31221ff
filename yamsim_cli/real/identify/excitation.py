"""Generate collision-free motions whose logs determine an arm's identifiable parameters."""

from __future__ import annotations

import copy
import csv
import io
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.errors import SimulationError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.recorded_motion import ArmMotion, RecordedMotion
from yamsim_cli.core.scene.arm_model import finger_addresses
from yamsim_cli.core.scene.blueprint import Blueprint
from yamsim_cli.core.scene.build import build_rig_scene
from yamsim_cli.core.scene.compose import add_home_key, compose_scene
from yamsim_cli.real.gap.command_simulation import simulate_commands

from ..recordings.csv_file import TIME_COLUMN, csv_columns, encode_csv
from .plant_model import ParametricArm

_COMMAND_RATE = 100  # commands per s
_MAX_SPEED, _MAX_TORQUE = 0.5, 0.5  # shares of the motors' maxima
_MAX_TRIES = 20  # motions, each in a smaller joint range

# Sum of sines per joint: number, lowest frequency, and range of the highest, Hz.
_SINE_COUNT, _MIN_FREQUENCY, _HIGHEST_FREQUENCY = 8, 0.1, (2.0, 5.0)
_FREQUENCY_PER_TURN = 2.0  # highest frequency, Hz, per turn/s of the motor's maximum speed
# Amplitude is frequency ** -exponent, of the slowest and the fastest joints: the fastest have small inertias, which
# only fast sines excite.
_AMPLITUDE_EXPONENTS = (0.8, 0.4)
# s, a cycle of the motion, and its share of sines. Slow sweeps fill the rest, so that each third of the motion has
# both: identification fits two thirds and tests on the last.
_CYCLE_SECONDS, _SINE_SHARE = 20.0, 0.6
_SWEEP_SPEEDS, _SWEEP_REST = (0.05, 0.5), 0.4  # rad/s, and s after each sweep
_RAMP_SECONDS = 2.0  # s, rise and fall of the sines' amplitude

# m, to table and other arms, and between parts of the arm: small, because collision boxes are larger than the parts.
_MIN_DISTANCE, _MIN_SELF_DISTANCE = 0.03, 0.003
_JOINT_MARGIN = 0.15  # rad, to the joint limits
_MAX_HALF_RANGE, _MIN_HALF_RANGE = 0.9, 0.2  # rad, to either side
_MIDDLE_TRIES, _RANGE_SAMPLES = 60, 60  # postures tried as the range's middle, and postures checked around each
_SHRINK_FACTOR = 0.85  # factor on a joint range with a collision


@dataclass(frozen=True)
class JointRange:
    """Middle (dof,) and extent to either side (dof,), rad."""

    middle: Array
    half_range: Array


@dataclass(frozen=True)
class Excitation:
    """A motion that excites an arm's identifiable parameters.

    Attributes:
        times: (n,), s.
        commands: joints (n, dof), rad. The arm starts and ends at the first.
        box: range of the commands.
        speed, torque: largest share of a motor's maximum, 0..1.
    """

    times: Array
    commands: Array
    joint_range: JointRange
    speed: float
    torque: float


def generate_excitation(
    rig: RigConfig, number: int, scene: SceneConfig, locations: Locations, seconds: float, seed: int
) -> Excitation:
    """Return a motion of arm `rig.arms[number]`, for `seconds`, that swings all joints, fast and slowly.

    Raises:
        SimulationError: no collision-free motion within the motors' limits was found.
    """
    rng = np.random.default_rng([seed, number])
    room, plant = CollisionSpace(rig, number, scene, locations), ParametricArm(rig.arms[number])
    box = room.widest_range(rng)
    motors = np.array([joint.motor_rad_s for joint in rig.arms[number].robot.joints])
    times = np.arange(round(seconds * _COMMAND_RATE) + 1) / _COMMAND_RATE
    for _ in range(_MAX_TRIES):
        shares = [
            _normalized_trajectory(times, float(half), float(motor), rng)
            for half, motor in zip(box.half_range, motors, strict=True)
        ]
        commands = box.middle + box.half_range * np.column_stack(shares)
        speed = float((np.abs(np.gradient(commands, times, axis=0)) / motors).max())
        torque = float((np.abs(_inverse_dynamics_torques(plant, times, commands)) / plant.max_torque).max())
        if speed <= _MAX_SPEED and torque <= _MAX_TORQUE and not any(room.is_colliding(row) for row in commands[::5]):
            return Excitation(times, commands, box, speed, torque)
        box = JointRange(box.middle, box.half_range * 0.9)
    raise SimulationError(
        f"{rig.arms[number].name}: no motion of {seconds:g} s was found within the limits of its motors; try "
        "another --seed"
    )


def commands_csv(rig: RigConfig, number: int, found: Excitation) -> bytes:
    """Return commands to all arms as CSV: other arms stay at home."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([name for name in csv_columns(rig) if name == TIME_COLUMN or name.startswith("command_")])
    for time, row in zip(found.times, np.hstack(_commands_per_arm(rig, number, found)), strict=True):
        writer.writerow([f"{time:.4f}", *(f"{value:.6f}" for value in row)])
    return stream.getvalue().encode()


def log_csv(rig: RigConfig, number: int, found: Excitation, surroundings: SceneConfig, locations: Locations) -> bytes:
    """Simulate a motion; return commands and encoder readings of all arms as CSV, without noise and quantization."""
    commands, arms = _commands_per_arm(rig, number, found), []
    for rows, k in zip(commands, rig.recording_order, strict=True):
        arm, dof = rig.arms[k], rig.arms[k].robot.dof
        openings = rows[:, dof] if arm.robot.fingers is not None else None
        side = arm.side if len(rig.arms) > 1 else ""
        arms.append(ArmMotion(side, rows[:, :dof], rows[:, :dof], openings, openings))
    followed = simulate_commands(
        build_rig_scene(rig, surroundings, locations), RecordedMotion("excite", found.times, tuple(arms))
    )
    read = [
        part
        for arm in followed.arms
        for part in (arm.joints, *([] if arm.openings is None else [arm.openings[:, None]]))
    ]
    return encode_csv(rig, found.times, np.column_stack([*commands, *read]))


def _commands_per_arm(rig: RigConfig, number: int, found: Excitation) -> list[Array]:
    """Return commands (n, drives) per arm in `rig.recording_order`, rad and m."""
    count, arms = len(found.times), []
    for k in rig.recording_order:
        robot = rig.arms[k].robot
        rows = found.commands if k == number else np.tile(robot.home, (count, 1))
        if robot.fingers is not None:
            rows = np.column_stack([rows, np.full(count, robot.fingers.initial_opening)])
        arms.append(rows)
    return arms


def _normalized_trajectory(times: Array, half: float, motor: float, rng: np.random.Generator) -> Array:
    """Return a joint's position in its range (n,), -1..1, which starts and ends at 0.

    `half` is the half range, rad, and `motor` the largest speed, rad/s.
    """
    fastest = float(np.clip(_FREQUENCY_PER_TURN * motor / (2 * np.pi), *_HIGHEST_FREQUENCY))
    cycles = max(1, round(times[-1] / _CYCLE_SECONDS))
    length = times[-1] / cycles
    quick = length * _SINE_SHARE
    number = np.clip((times // length).astype(int), 0, cycles - 1)
    found = np.empty(len(times))
    for cycle in range(cycles):
        here = number == cycle
        now = times[here] - cycle * length
        ramp = np.minimum(_smooth_step(now / _RAMP_SECONDS), _smooth_step((quick - now) / _RAMP_SECONDS))
        found[here] = np.where(
            now < quick, ramp * _random_sine_sum(now, fastest, rng), _slow_sweeps(quick, length, half, rng)(now)
        )
    return found


def _random_sine_sum(times: Array, fastest: float, rng: np.random.Generator) -> Array:
    edges = np.geomspace(_MIN_FREQUENCY, fastest, _SINE_COUNT + 1)
    frequencies = rng.uniform(edges[:-1], edges[1:])
    sizes = frequencies ** -np.interp(fastest, _HIGHEST_FREQUENCY, _AMPLITUDE_EXPONENTS)
    total = (sizes * np.sin(2 * np.pi * frequencies * times[:, None] + rng.uniform(0, 2 * np.pi, _SINE_COUNT))).sum(
        axis=1
    )
    found: Array = total / np.abs(total).max()
    return found


def _slow_sweeps(start: float, end: float, half: float, rng: np.random.Generator) -> Callable[[Array], Array]:
    """Return times (n,), s, -> positions (n,), -1..1, that sweep slowly to both sides, from 0 to 0."""
    knots, places, now, side = [start], [0.0], start, float(rng.choice([-1, 1]))
    while True:
        place, speed = side * rng.uniform(0.3, 1.0), np.exp(rng.uniform(*np.log(_SWEEP_SPEEDS)))
        turn = abs(place - places[-1]) * half / speed
        back = abs(place) * half / _SWEEP_SPEEDS[1] * 2
        if now + turn + _SWEEP_REST + back + _RAMP_SECONDS > end:
            break
        knots += [now + turn, now + turn + _SWEEP_REST]
        places += [place, place]
        now, side = knots[-1], -side
    rest = max(abs(places[-1]) * half / _SWEEP_SPEEDS[1] * 2, 1e-3)
    knots += [now + rest, end + 1]
    places += [0.0, 0.0]
    when, where = np.array(knots), np.array(places)

    def sweep_positions(times: Array) -> Array:
        k = np.clip(np.searchsorted(when, times, side="right") - 1, 0, len(when) - 2)
        share = (times - when[k]) / (when[k + 1] - when[k])
        found: Array = where[k] + (where[k + 1] - where[k]) * _smooth_step(share)
        return found

    return sweep_positions


def _smooth_step(share: Array) -> Array:
    inside = np.clip(share, 0, 1)
    found: Array = inside**3 * (10 - 15 * inside + 6 * inside**2)
    return found


def _inverse_dynamics_torques(plant: ParametricArm, times: Array, joints: Array) -> Array:
    data, found = mujoco.MjData(plant.model), np.empty(joints.shape)
    speeds = np.gradient(joints, times, axis=0)
    accelerations = np.gradient(speeds, times, axis=0)
    for k, row in enumerate(joints):
        data.qpos[plant.qpos], data.qvel[plant.dof], data.qacc[plant.dof] = row, speeds[k], accelerations[k]
        mujoco.mj_inverse(plant.model, data)
        found[k] = data.qfrc_inverse[plant.dof]
    return found


class CollisionSpace:
    """Checks whether an arm is too near to the table, other arms or itself."""

    def __init__(self, rig: RigConfig, number: int, scene: SceneConfig, locations: Locations) -> None:
        arm = rig.arms[number]
        spec = compose_scene(
            Blueprint(rig, scene.widened_for_arm_distance(rig.arm_span), boards=False, background=False), locations
        )
        model = add_home_key(spec, rig, {})
        self._model = copy.copy(model)
        self._data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, self._data, 0)
        self._qpos = np.array([model.joint(arm.prefix + name).qposadr[0] for name in arm.robot.joint_names])
        if arm.robot.fingers is not None:
            addresses, signs = finger_addresses(model, arm.robot, arm.prefix)
            self._data.qpos[addresses] = arm.robot.fingers.initial_opening * signs
        base = model.body(arm.prefix + arm.robot.base).id
        self._own_geoms = model.body_rootid[model.geom_bodyid] == base
        self._moving_geoms = self._own_geoms & (model.geom_bodyid != base)
        hand = np.zeros(model.nbody, bool)
        hand[model.body(arm.prefix + arm.robot.flange).id] = True
        for body in range(1, model.nbody):
            hand[body] |= hand[model.body_parentid[body]]
        self._hand_geoms = hand[model.geom_bodyid]
        self._model.geom_margin[:] = np.where(self._own_geoms, _MIN_DISTANCE, 0.0)
        self._range, self._name = arm.robot.joint_range, arm.name

    def is_colliding(self, joints: Array) -> bool:
        """Whether joints (dof,), rad, are too near."""
        self._data.qpos[self._qpos] = joints
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_collision(self._model, self._data)
        geoms, distance = self._data.contact.geom, self._data.contact.dist
        near = distance < np.where(self._own_geoms[geoms].all(axis=1), _MIN_SELF_DISTANCE, _MIN_DISTANCE)
        # A hand's parts are always near each other.
        return bool((near & self._moving_geoms[geoms].any(axis=1) & ~self._hand_geoms[geoms].all(axis=1)).any())

    def widest_range(self, rng: np.random.Generator) -> JointRange:
        """Return the widest of random joint ranges in which no sampled posture collides.

        Raises:
            SimulationError: no range is wide enough.
        """
        low, high = self._range[:, 0] + _JOINT_MARGIN, self._range[:, 1] - _JOINT_MARGIN
        best: JointRange | None = None
        for _ in range(_MIDDLE_TRIES):
            middle = rng.uniform(low + _MIN_HALF_RANGE, high - _MIN_HALF_RANGE)
            half = np.minimum(np.minimum(middle - low, high - middle), _MAX_HALF_RANGE)
            box = self._collision_free_range(middle, half, rng)
            if box is not None and (best is None or _joint_range_score(box) > _joint_range_score(best)):
                best = box
        if best is None:
            raise SimulationError(
                f"{self._name}: no pose was found around which every joint can swing by {_MIN_HALF_RANGE} rad without "
                f"coming nearer than {1000 * _MIN_DISTANCE:g} mm to anything; give the arm more room"
            )
        return best

    def _collision_free_range(self, middle: Array, half: Array, rng: np.random.Generator) -> JointRange | None:
        sides = rng.uniform(-1, 1, (_RANGE_SAMPLES, len(middle)))
        # Every second posture is a corner.
        sides[::2] = np.sign(sides[::2])
        while half.min() >= _MIN_HALF_RANGE:
            if not any(self.is_colliding(middle + half * side) for side in sides):
                return JointRange(middle, half)
            half = half * _SHRINK_FACTOR
        return None


def _joint_range_score(box: JointRange) -> float:
    return float(np.log(box.half_range).mean() + np.log(box.half_range.min()))
