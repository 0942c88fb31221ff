"""A session's simulated arms on simulated buses, for programs that drive real arms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from yamsim_cli.core.attempt_data import ArmPosture, AttemptJob
from yamsim_cli.core.config.recording import SCENE_CAMERA, RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.sampling import sample_attempt
from yamsim_cli.core.episode.simulator import Simulator, make_simulator
from yamsim_cli.core.errors import SimulationError, UsageError
from yamsim_cli.core.geometry.se3 import Array

from ..motors.can_config import load_can_config
from ..motors.motor import MOTOR_KINDS, Motor
from ..motors.motor_bus import BusFault, MotorBus
from .follower import JointController
from .motor_simulation import MotorSimulation
from .policy_robot import HandKinematics, PolicyRobot
from .render_process import RenderProcess, SceneState

# Initial postures: folded, at rest without power; the model's home; the task's start.
VALID_START_POSTURES = ("rest", "home", "task")


@dataclass(frozen=True)
class ServedArms:
    """Simulated arms that other programs drive; `sides` and `followers` are in the order of the buses."""

    motor_simulation: MotorSimulation
    sides: tuple[str, ...]
    followers: tuple[JointController, ...]

    def scene_state(self) -> SceneState:
        """Return the state to render."""
        joints = tuple(follower.joint_pos() for follower in self.followers)
        return SceneState(self.motor_simulation.data.qpos.copy(), self.motor_simulation.sim_time, joints)


def channel_names(sides: Sequence[str], given: Sequence[str]) -> tuple[str, ...]:
    """Return the buses' names: the given ones, or `can0`, or `can_left` and `can_right`.

    Raises:
        UsageError: the number of names is wrong, two are equal, or one is invalid.
    """
    if not given:
        return ("can0",) if len(sides) == 1 else tuple(f"can_{side}" for side in sides)
    if len(given) != len(sides) or len(set(given)) < len(given):
        raise UsageError(
            f"--channel {' '.join(given)} is not valid: give {len(sides)} different names, one for each arm: "
            f"{', '.join(sides)}"
        )
    for name in given:
        if not name.isascii() or not name.replace("_", "").replace("-", "").isalnum() or len(name) > 15:
            raise UsageError(f"--channel {name!r} is not valid: up to 15 letters, digits, - and _, such as can0")
    return tuple(given)


def served_cameras(config: RecordConfig) -> tuple[str, ...]:
    """Return the cameras of config or rig, if any, else the scene camera and all wrist cameras."""
    if config.cameras is not None or config.rig.cameras:
        return config.recorded_cameras
    return SCENE_CAMERA, *(config.rig.arms[k].wrist_camera_name for k in config.rig.recording_order)


def make_policy_robot(session: Session, served: ServedArms, source: RenderProcess) -> PolicyRobot:
    """Return the robot for raiden's policies, with raiden's wrist camera names, such as `left_wrist_camera`."""
    arms = [session.config.rig.arms[k] for k in session.config.rig.recording_order]
    wrists = {arm.wrist_camera_name: f"{arm.side}_wrist_camera" for arm in arms}
    names = {camera: wrists.get(camera, camera) for camera in source.cameras}
    hands = [HandKinematics(arm) for arm in arms]
    return PolicyRobot(served.motor_simulation, served.sides, served.followers, hands, source, names)


def serve_arms(
    session: Session,
    channels: Sequence[str] = (),
    faults: Sequence[BusFault] = (),
    start: str = "rest",
) -> ServedArms:
    """Return a rig's simulated arms, with the task's objects at their initial poses.

    Args:
        channels: as `given` in `channel_names`.
        start: one of `VALID_START_POSTURES`.

    Raises:
        ConfigError: the motors of an arm or a gripper are unknown.
        UsageError: a channel's name is invalid, or a fault's channel or motor does not exist.
        SimulationError: the scene cannot be compiled, or the objects have no room.
    """
    config = session.config
    arms = [config.rig.arms[number] for number in config.rig.recording_order]
    sides = tuple(arm.side for arm in arms)
    names = channel_names(sides, channels)
    wirings = tuple(
        load_can_config(
            arm.robot.model, arm.robot.gripper if arm.robot.fingers else None, arm.robot.dof, session.locations
        )
        for arm in arms
    )
    buses = []
    for name, wiring in zip(names, wirings, strict=True):
        motors = [Motor(row.id, MOTOR_KINDS[row.kind]) for row in wiring.arm.motors]
        if wiring.gripper is not None:
            motors.append(Motor(wiring.gripper.id, MOTOR_KINDS[wiring.gripper.kind]))
        buses.append(MotorBus(name, motors, faults, config.seed))
    _check_faults(faults, buses)
    with make_simulator(session.without_meshes(), AttemptJob(config.seed, 0)) as simulator:
        scene = simulator.scene
        plant = MotorSimulation(scene, _start_qpos(simulator, config, start), wirings, buses)
    rows = enumerate(zip(scene.arms, wirings, strict=True))
    return ServedArms(plant, sides, tuple(JointController(plant, k, arm, wiring) for k, (arm, wiring) in rows))


def _start_qpos(simulator: Simulator, config: RecordConfig, start: str) -> Array:
    scene = simulator.scene
    layout = sample_attempt(simulator, AttemptJob(config.seed, 0)).layout
    if layout is None:
        raise SimulationError(f"task {config.task.name!r}: the sampling box has no room for its objects")
    postures = []
    for arm in scene.arms:
        robot = config.rig.arms[arm.number].robot
        joints = {"rest": np.zeros(arm.dof), "home": robot.home, "task": robot.start}[start]
        postures.append(ArmPosture(np.array(joints), 0.0))
    return scene.start_qpos(layout, postures)


def _check_faults(faults: Sequence[BusFault], buses: Sequence[MotorBus]) -> None:
    for fault in faults:
        meant = [bus for bus in buses if fault.channel in ("", bus.channel)]
        if not meant:
            there = ", ".join(bus.channel for bus in buses)
            raise UsageError(f"--fault {fault.kind}: no channel {fault.channel!r}; valid: {there}")
        numbers = sorted({motor.number for bus in meant for motor in bus.motors})
        if fault.motor and fault.motor not in numbers:
            raise UsageError(f"--fault {fault.kind}: no motor {fault.motor}; valid: {', '.join(map(str, numbers))}")
