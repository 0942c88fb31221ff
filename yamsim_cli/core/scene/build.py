"""The scene of a recording, or of a rig alone, compiled, with the addresses of its parts."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from ..config.recording import RecordConfig
from ..config.rig import ArmConfig, RigConfig
from ..config.scene import SceneConfig
from ..config.things.thing import ObjectConfig
from ..resources import Locations
from ..robots.models import Fingers
from ..session import Session
from .blueprint import Blueprint, TaskPhysics, recording_blueprint
from .cloth import grip_name, rest_points
from .compiled import CompiledScene, Ids, Kind, SceneArm, SceneCloth, SceneFingers
from .compiling import compile_spec
from .compose import READING, WELD, compose
from .composed_meshes import composed_meshes

# Of physics of a rig alone, s: that of the tasks, unless they say otherwise.
TIMESTEP = 0.002


def build_scene(session: Session) -> CompiledScene:
    """Compose and compile the scene of a recording.

    Raises:
        SimulationError: MuJoCo refused the composed model.
    """
    config, locations = session.config, session.locations
    blueprint = recording_blueprint(config)
    model = compile_spec(compose(blueprint, locations))
    objects = [item.name for item in config.task.objects if item.cloth is None]
    geom_kind, geom_arm = _geoms(model, config.rig)
    geom_kind[model.geom("table").id] = Kind.TABLE
    welds = config.grasp == "weld"
    return CompiledScene(
        model=model,
        arms=tuple(_arm_addresses(model, config.rig, number, welds=welds) for number in config.rig.recorded),
        object_qpos={name: int(model.joint(name).qposadr[0]) for name in objects},
        object_dof={name: int(model.joint(name).dofadr[0]) for name in objects},
        cameras=config.recorded_cameras,
        geom_kind=geom_kind,
        geom_arm=geom_arm,
        cloths={item.name: _cloth_addresses(model, config, item) for item in config.task.objects if item.cloth},
    )


def build_rig_scene(
    rig: RigConfig, scene: SceneConfig, locations: Locations, timestep: float = TIMESTEP
) -> CompiledScene:
    """Compose and compile a rig's arms and nothing else that they could touch: no floor, no table, no boards.

    Args:
        scene: its looks do not matter here; its table is left out.
        timestep: of physics, s.

    Raises:
        SimulationError: MuJoCo refused the composed model.
    """
    physics = TaskPhysics(timestep, impratio=None, carried=None)
    bare = scene.model_copy(update={"table": None})
    blueprint = Blueprint(rig, bare, boards=False, background=False, physics=physics)
    model = compile_spec(compose(blueprint, locations))
    geom_kind, geom_arm = _geoms(model, rig)
    return CompiledScene(
        model=model,
        arms=tuple(_arm_addresses(model, rig, number, welds=False) for number in rig.recorded),
        object_qpos={},
        object_dof={},
        cameras=(),
        geom_kind=geom_kind,
        geom_arm=geom_arm,
    )


def shown_meshes(session: Session) -> dict[str, str]:
    """Return what a session shows of each mesh set, see `core.shown_meshes`.

    The files of a set are those of all things that the task may draw, so that every cast of a task has the same text.
    """
    blueprint = recording_blueprint(session.config)
    return composed_meshes(compose(blueprint, session.locations), blueprint, session.locations.meshes)


def noting_meshes(session: Session) -> Session:
    """Return the same session with a config that says which meshes the session shows."""
    return session.with_values(meshes=shown_meshes(session))


def _arm_addresses(model: mujoco.MjModel, rig: RigConfig, number: int, *, welds: bool) -> SceneArm:
    arm = rig.arms[number]
    robot = arm.robot
    joints = [model.joint(arm.prefix + name) for name in robot.joint_names]
    moving = np.array([model.actuator(arm.prefix + name).id for name in robot.joint_drives])
    return SceneArm(
        number=number,
        prefix=arm.prefix,
        flange=arm.prefix + robot.flange,
        joint_qpos=np.array([joint.qposadr[0] for joint in joints]),
        joint_dof=np.array([joint.dofadr[0] for joint in joints]),
        arm_ctrl=moving,
        kp=model.actuator_gainprm[moving, 0].copy(),
        kv=-model.actuator_biasprm[moving, 2],
        ctrl_range=model.actuator_ctrlrange[moving].copy(),
        weld=model.equality(arm.prefix + WELD).id if welds else None,
        T_base_in_world=rig.T_base_in_world(number),
        joint_range=robot.joint_range,
        motor_speed=np.array([joint.motor_rad_s for joint in robot.joints]),
        most_torque=model.actuator_forcerange[moving, 1].copy(),
        fingers=None if robot.fingers is None else _finger_addresses(model, arm, robot.fingers),
        **_otherwise(model, arm),
    )


def _otherwise(model: mujoco.MjModel, arm: ArmConfig) -> dict[str, Any]:
    """What of an arm's dynamics no MJCF says, and where it is read late, as `SceneArm` has it."""
    found: dict[str, Any] = {}
    fingers = arm.robot.fingers
    read = [arm.prefix + name + READING for name in (*arm.robot.joint_names, *(fingers.joints[:1] if fingers else ()))]
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, read[0]) >= 0:
        found["sensors"] = np.array([model.sensor(name).id for name in read])
    if arm.dynamics is None:
        return found
    joints = [arm.dynamics.joint(name) for name in arm.robot.joint_names]
    gravity = np.array([joint.gravity_factor - 1 for joint in joints])
    offset = np.array([joint.offset_rad for joint in joints])
    return found | {
        "gravity": gravity if gravity.any() else None,
        "offset": offset,
        "command_delay": arm.dynamics.command_delay_ms / 1000,
        "sensor_delay": arm.dynamics.sensor_delay_ms / 1000,
        "sensor_noise": arm.dynamics.sensor_noise_rad,
        "encoder_step": arm.dynamics.encoder_step_rad,
    }


def _cloth_addresses(model: mujoco.MjModel, config: RecordConfig, item: ObjectConfig) -> SceneCloth:
    cloth, name = item.cloth, item.name
    assert cloth is not None, "not called for anything else"
    rest = rest_points(cloth)
    prefixes = [config.rig.arms[number].prefix for number in config.rig.recorded]
    joints = [[model.joint(f"{name}_{k}_{axis}") for axis in "xyz"] for k in range(len(rest))]
    return SceneCloth(
        flex=int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_FLEX, name)),
        grid=cloth.grid,
        rest=rest,
        qpos=np.array([[joint.qposadr[0] for joint in axes] for axes in joints]),
        dof=np.array([[joint.dofadr[0] for joint in axes] for axes in joints]),
        grips=np.array(
            [[model.equality(grip_name(prefix, name, k)).id for k in range(len(rest))] for prefix in prefixes]
        ),
        radius=cloth.radius,
        spacing=cloth.spacing,
        by_layers=cloth.held == "layers",
    )


def _finger_addresses(model: mujoco.MjModel, arm: ArmConfig, fingers: Fingers) -> SceneFingers:
    drive, joints = model.actuator(arm.prefix + fingers.drive), [model.joint(arm.prefix + j) for j in fingers.joints]
    return SceneFingers(
        qpos=np.array([joint.qposadr[0] for joint in joints]),
        dof=np.array([joint.dofadr[0] for joint in joints]),
        sign=np.array(arm.robot.finger_signs),
        ctrl=drive.id,
        gain=float(drive.gainprm[0]),
        ctrl_range=drive.ctrlrange.copy(),
        stops=fingers.range,
        stroke=fingers.full_opening,
        pads=fingers.pads,
    )


def _with_what_hangs_on(model: mujoco.MjModel, body: int) -> list[int]:
    """A body and all below it: MuJoCo numbers parents before their children."""
    found = [body]
    for other in range(body + 1, model.nbody):
        if model.body_parentid[other] in found:
            found.append(other)
    return found


def _geoms(model: mujoco.MjModel, rig: RigConfig) -> tuple[Ids, Ids]:
    """`Kind` of every geom (ngeom,) as far as it is an arm's, and the number in `CompiledScene.arms` of the arm that it
    belongs to, or -1.
    """
    kind = np.full(model.nbody, int(Kind.OTHER))
    of_arm = np.full(model.nbody, -1)
    for k, number in enumerate(rig.recorded):
        prefix, robot = rig.arms[number].prefix, rig.arms[number].robot
        on_arm = model.body_rootid == model.body(prefix + robot.base).id
        kind[on_arm], of_arm[on_arm] = Kind.ARM, k
        if robot.fingers is not None:
            for name, finger in zip(robot.fingers.bodies, (Kind.LEFT_FINGER, Kind.RIGHT_FINGER), strict=True):
                kind[_with_what_hangs_on(model, model.body(prefix + name).id)] = finger
    kinds: Ids = kind[model.geom_bodyid]
    arms: Ids = of_arm[model.geom_bodyid]
    return kinds, arms
