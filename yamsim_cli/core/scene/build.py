"""The scene of a recording: a composed rig with the task's objects, the weld and the cameras, compiled."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from ..config.limits import load_limits
from ..config.record import RecordConfig
from ..config.rig import ArmConfig
from ..config.scene import FixedCamera
from ..drawn import Drawn
from ..geometry.camera import opencv_from_mujoco
from ..geometry.se3 import Array, quat_from_rotation
from ..resources import Locations
from .compiled import CompiledScene, Ids, Kind, SceneArm
from .compose import Contents, compile_spec, compose
from .drawn import drawn_meshes
from .quality import apply_quality
from .randomize import prepare_randomization
from .robot import ACTUATORS, FINGERS, JOINTS, Meshes, fingers

SCENE_CAMERA = "scene_camera"
WELD = "grasp_weld"


def build_scene(config: RecordConfig, locations: Locations, meshes: Meshes) -> CompiledScene:
    """Compose and compile the scene of a recording.

    Args:
        config: rig, surroundings, task, image size and render settings.
        locations: where the robot models are.
        meshes: asset set -> folder of its files, or None to show primitives.

    Raises:
        SimulationError: MuJoCo refused the composed model.
    """
    spec = _composed(config, locations, meshes)
    drawn = drawn_meshes(spec, config, meshes)
    spec.modelname = f"{config.rig.name}_{config.scene.name}_{config.task.name}"
    apply_quality(spec, config.render, config.image.size_px)
    add_task_physics(spec, config)

    cameras = [SCENE_CAMERA]
    add_scene_camera(spec, config)
    for arm in config.wrist_arms:
        add_wrist_camera(spec, arm)
        cameras.append(arm.wrist_camera_name)
    return _addresses(compile_spec(spec), config, tuple(cameras), locations, drawn)


def noting_meshes(config: RecordConfig, locations: Locations, meshes: Meshes) -> RecordConfig:
    """A recording's config that says which meshes its scene shows; see `build_scene`."""
    drawn = drawn_meshes(_composed(config, locations, meshes), config, meshes)
    return config.model_copy(update={"meshes": drawn})


def _composed(config: RecordConfig, locations: Locations, meshes: Meshes) -> mujoco.MjSpec:
    """The scene with all that is seen in it."""
    contents = Contents(boards=config.boards, objects=(config.task.object, config.task.target))
    spec = compose(config.rig, config.surroundings, contents, locations, meshes)
    prepare_randomization(spec, config.randomization, meshes)
    return spec


def add_task_physics(spec: mujoco.MjSpec, config: RecordConfig) -> None:
    """What a recording steps with: its time step, contacts that hold where nothing else does, and the welds."""
    spec.option.timestep = config.task.timing.timestep
    if config.grasp == "contact":
        # MuJoCo's friction creeps, and with its defaults an object turns by a few degrees a second in the hand. Source:
        # MuJoCo's documentation of `impratio`, which asks for elliptic cones with it.
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        spec.option.impratio = 10
    for arm in config.rig.arms:
        add_grasp_weld(spec, config.task.object.name, arm.prefix)


def add_scene_camera(spec: mujoco.MjSpec, config: RecordConfig) -> None:
    """Add the camera of a recording's surroundings."""
    camera = config.surroundings.scene_camera
    assert camera is not None  # checked when the config was loaded
    add_fixed_camera(spec, SCENE_CAMERA, camera)


def add_grasp_weld(spec: mujoco.MjSpec, item: str, prefix: str = "") -> None:
    """Add the weld that can hold an object to an arm's `link_6`; it starts inactive."""
    spec.add_equality(
        name=prefix + WELD,
        type=mujoco.mjtEq.mjEQ_WELD,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        name1=f"{prefix}link_6",
        name2=item,
        active=False,
    )


def add_fixed_camera(spec: mujoco.MjSpec, name: str, camera: FixedCamera) -> None:
    """Add a camera that stands still in `world`."""
    spec.worldbody.add_camera(
        name=name, pos=camera.position, quat=quat_from_rotation(_look_at(camera)), fovy=camera.fovy_deg
    )


def _look_at(camera: FixedCamera) -> Array:
    """Rotation (3, 3) of a MuJoCo camera frame in `world`: -z towards the target, +y as far up as it can be."""
    forward = np.asarray(camera.look_at) - np.asarray(camera.position)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    if np.linalg.norm(right) < 1e-6:
        # Straight up or down: image up is then +x, away from the arm.
        right = np.array([0.0, -1.0, 0.0]) * math.copysign(1.0, -forward[2])
    right /= np.linalg.norm(right)
    return np.column_stack([right, np.cross(right, forward), -forward])


def add_wrist_camera(spec: mujoco.MjSpec, arm: ArmConfig) -> None:
    """Add an arm's wrist camera, which moves with its hand."""
    camera = arm.wrist_camera
    x = np.asarray(camera.x_axis) / np.linalg.norm(camera.x_axis)
    y = np.asarray(camera.y_axis) / np.linalg.norm(camera.y_axis)
    R = opencv_from_mujoco(np.column_stack([x, y, np.cross(x, y)]))
    spec.body(f"{arm.prefix}link_6").add_camera(
        name=arm.wrist_camera_name, pos=camera.position, quat=quat_from_rotation(R), fovy=camera.fovy_deg
    )


def _addresses(
    model: mujoco.MjModel, config: RecordConfig, cameras: tuple[str, ...], locations: Locations, drawn: Drawn
) -> CompiledScene:
    objects = (config.task.object.name, config.task.target.name)
    geom_kind, geom_arm = _geoms(model, config)
    return CompiledScene(
        model=model,
        arms=tuple(_arm_addresses(model, config, number, locations) for number in config.rig.recorded),
        object_qpos={name: int(model.joint(name).qposadr[0]) for name in objects},
        object_dof={name: int(model.joint(name).dofadr[0]) for name in objects},
        cameras=cameras,
        geom_kind=geom_kind,
        geom_arm=geom_arm,
        drawn=drawn,
    )


def _arm_addresses(model: mujoco.MjModel, config: RecordConfig, number: int, locations: Locations) -> SceneArm:
    arm = config.rig.arms[number]
    joints = [model.joint(arm.prefix + name) for name in JOINTS]
    drives = [model.actuator(arm.prefix + name).id for name in ACTUATORS]
    moving, gripper = np.array(drives[:6]), drives[6]
    gripper_qpos, gripper_sign = fingers(model, arm.prefix)
    limits = load_limits(arm.model, locations).joints_with(arm.gripper)
    return SceneArm(
        number=number,
        prefix=arm.prefix,
        joint_qpos=np.array([joint.qposadr[0] for joint in joints]),
        joint_dof=np.array([joint.dofadr[0] for joint in joints]),
        gripper_qpos=gripper_qpos,
        gripper_sign=gripper_sign,
        arm_ctrl=moving,
        gripper_ctrl=gripper,
        kp=model.actuator_gainprm[moving, 0].copy(),
        kv=-model.actuator_biasprm[moving, 2],
        ctrl_range=model.actuator_ctrlrange[moving].copy(),
        weld=model.equality(arm.prefix + WELD).id,
        T_base_in_world=config.rig.T_base_in_world(number),
        joint_range=np.array([joint.range for joint in limits]),
        motor_speed=np.array([joint.motor_rad_s for joint in limits]),
        most_torque=model.actuator_forcerange[moving, 1].copy(),
        grip_gain=float(model.actuator_gainprm[gripper, 0]),
        grip_range=model.actuator_ctrlrange[gripper].copy(),
    )


def _geoms(model: mujoco.MjModel, config: RecordConfig) -> tuple[Ids, Ids]:
    """`Kind` of every geom (ngeom,), and the number in `CompiledScene.arms` of the arm that it belongs to, or -1."""
    kind = np.full(model.nbody, int(Kind.OTHER))
    of_arm = np.full(model.nbody, -1)
    for k, number in enumerate(config.rig.recorded):
        prefix = config.rig.arms[number].prefix
        base, left, right = (model.body(prefix + name).id for name in ("arm", *FINGERS))
        on_arm = model.body_rootid == base
        kind[on_arm], of_arm[on_arm] = Kind.ARM, k
        kind[left], kind[right] = Kind.LEFT_FINGER, Kind.RIGHT_FINGER
    kind[model.body(config.task.object.name).id] = Kind.OBJECT
    kind[model.body(config.task.target.name).id] = Kind.TARGET
    kinds: Ids = kind[model.geom_bodyid]
    kinds[model.geom("table").id] = Kind.TABLE
    arms: Ids = of_arm[model.geom_bodyid]
    return kinds, arms
