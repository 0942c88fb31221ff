from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

import mujoco
import numpy as np

from ...loose_pieces import loose_pieces, stacked_poses
from ..config.mesh_provenance import FULL_MESHES, PRIMITIVES_ONLY, REDUCED_MESHES
from ..config.objects.object_config import ObjectConfig
from ..config.recording import RecordConfig
from ..config.rig import ArmConfig, RigConfig
from ..config.scene import SceneConfig
from ..config.session import Session
from ..config.task_objects import Region
from ..files.resources import Locations
from ..files.writing import sha256_bytes
from ..geometry.se3 import pose, rotation_z
from ..robots.models import Fingers
from .assets.mesh_reduction import REPORT_FILE
from .blueprint import Blueprint, TaskPhysics, recording_blueprint
from .cloth import LEAVING_BIT, cloth_grasp_constraint_name, flat_points
from .compilation import compile_spec
from .compiled import ArmAddresses, ClothAddresses, CompiledScene, ContainerRegion, FingerAddresses, GeomOwnerKind, Ids
from .compose import READING_SUFFIX, WELD_NAME, compose_scene, visual_mesh_sets

TIMESTEP = 0.002  # s, of physics for a rig without a task; equal to the step of tasks
_MOUNT_MESHES_KEY = "mounts"  # key, among the asset sets, of the board mounts whose STL file a user supplies


def build_scene(session: Session) -> CompiledScene:
    """Compile a recording's scene."""
    config, locations = session.config, session.locations
    blueprint = recording_blueprint(config)
    model = compile_spec(compose_scene(blueprint, locations))
    objects = [item.name for item in config.task.objects if item.cloth is None]
    geom_kind, geom_arm = _geom_owners(model, config.rig)
    geom_kind[model.geom("table").id] = GeomOwnerKind.TABLE
    pieces = {name: [model.joint(one.name).id for one in made] for name, made in loose_pieces(config.task).items()}
    for name, joints in pieces.items():
        model.qpos0[model.jnt_qposadr[joints][:, None] + np.arange(7)] = stacked_poses(config.task, name)
    welds = config.grasp == "weld"
    scene = CompiledScene(
        model=model,
        arms=tuple(_arm_addresses(model, config.rig, number, welds=welds) for number in config.rig.recording_order),
        object_qpos={name: int(model.joint(name).qposadr[0]) for name in objects},
        object_dof={name: int(model.joint(name).dofadr[0]) for name in objects},
        cameras=config.recorded_cameras,
        geom_kind=geom_kind,
        geom_arm=geom_arm,
        cloths={item.name: _cloth_addresses(model, config, item) for item in config.task.objects if item.cloth},
        pieces=pieces,
        regions={name: _container_region(config, region) for name, region in config.task.regions.items()},
    )
    if scene.releases_clear:
        # Fingers that leave cloth keep their contacts with other fingers.
        fingers = np.concatenate([geoms for pair in scene.finger_geoms for geoms in pair])
        model.geom_conaffinity[fingers[model.geom_conaffinity[fingers] != 0]] |= LEAVING_BIT
    return scene


def _container_region(config: RecordConfig, region: Region) -> ContainerRegion:
    T = pose(region.position, rotation_z(math.radians(region.yaw_deg)))
    return ContainerRegion(config.task.typical_roles.object_of(region.of), T, np.array(region.size))


def build_rig_scene(
    rig: RigConfig, scene: SceneConfig, locations: Locations, timestep: float = TIMESTEP
) -> CompiledScene:
    """Compile a rig's arms alone, without floor, table and boards; `scene` has no effect on physics."""
    physics = TaskPhysics(timestep, impratio=None, weld_placeholder=None)
    bare = scene.model_copy(update={"table": None})
    blueprint = Blueprint(rig, bare, boards=False, background=False, physics=physics)
    model = compile_spec(compose_scene(blueprint, locations))
    geom_kind, geom_arm = _geom_owners(model, rig)
    return CompiledScene(
        model=model,
        arms=tuple(_arm_addresses(model, rig, number, welds=False) for number in rig.recording_order),
        object_qpos={},
        object_dof={},
        cameras=(),
        geom_kind=geom_kind,
        geom_arm=geom_arm,
    )


def describe_meshes(session: Session) -> dict[str, str]:
    """Return asset set -> `primitives`, `full <SHA-256>` or `reduced <SHA-256>` for the meshes in a session's images.

    The hash covers the files of all objects that the task can use, so it is equal for all role assignments.
    """
    blueprint, folders = recording_blueprint(session.config), session.locations.meshes
    spec = compose_scene(blueprint, session.locations)
    assets = spec.assets
    files: dict[str, dict[str, bytes]] = {}
    for mesh in spec.meshes:
        path = PurePosixPath(mesh.file)
        files.setdefault(path.parent.name, {})[path.name] = assets[mesh.file]
    found = {name: _describe_mesh_set(folders.get(name), files.get(name, {})) for name in visual_mesh_sets(blueprint)}
    own = {f"{arm.mount.name}.stl" for arm in blueprint.rig.arms if arm.mount and arm.mount.stl}
    if mounts := {name: data for name, data in files.get(_MOUNT_MESHES_KEY, {}).items() if name in own}:
        found[_MOUNT_MESHES_KEY] = _describe_mesh_set(None, mounts)
    return found


def _describe_mesh_set(folder: Path | None, files: Mapping[str, bytes]) -> str:
    if not files:
        return PRIMITIVES_ONLY
    kind = REDUCED_MESHES if folder is not None and (folder / REPORT_FILE).is_file() else FULL_MESHES
    listed = "".join(f"{name} {sha256_bytes(files[name])}\n" for name in sorted(files))
    return f"{kind} {sha256_bytes(listed.encode())}"


def with_mesh_descriptions(session: Session) -> Session:
    """Return the session with the result of `describe_meshes` in its config's field `meshes`."""
    return session.with_values(meshes=describe_meshes(session))


def _arm_addresses(model: mujoco.MjModel, rig: RigConfig, number: int, *, welds: bool) -> ArmAddresses:
    arm = rig.arms[number]
    robot = arm.robot
    joints = [model.joint(arm.prefix + name) for name in robot.joint_names]
    drives = np.array([model.actuator(arm.prefix + name).id for name in robot.joint_drives])
    return ArmAddresses(
        number=number,
        prefix=arm.prefix,
        flange=arm.prefix + robot.flange,
        joint_qpos=np.array([joint.qposadr[0] for joint in joints]),
        joint_dof=np.array([joint.dofadr[0] for joint in joints]),
        arm_ctrl=drives,
        position_gain=model.actuator_gainprm[drives, 0].copy(),
        velocity_gain=-model.actuator_biasprm[drives, 2],
        ctrl_range=model.actuator_ctrlrange[drives].copy(),
        weld=model.equality(arm.prefix + WELD_NAME).id if welds else None,
        T_base_in_world=rig.T_base_in_world(number),
        joint_range=robot.joint_range,
        motor_speed=np.array([joint.motor_rad_s for joint in robot.joints]),
        max_torque=model.actuator_forcerange[drives, 1].copy(),
        fingers=None if robot.fingers is None else _finger_addresses(model, arm, robot.fingers),
        **_dynamics_attributes(model, arm),
    )


def _dynamics_attributes(model: mujoco.MjModel, arm: ArmConfig) -> dict[str, Any]:
    found: dict[str, Any] = {}
    fingers = arm.robot.fingers
    read = [
        arm.prefix + name + READING_SUFFIX
        for name in (*arm.robot.joint_names, *(fingers.joints[:1] if fingers else ()))
    ]
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, read[0]) >= 0:
        found["sensors"] = np.array([model.sensor(name).id for name in read])
    if arm.dynamics is None:
        return found
    joints = [arm.dynamics.joint(name) for name in arm.robot.joint_names]
    gravity = np.array([joint.gravity_factor - 1 for joint in joints])
    offset = np.array([joint.offset_rad for joint in joints])
    return found | {
        "gravity_error": gravity if gravity.any() else None,
        "encoder_offset": offset,
        "command_delay": arm.dynamics.command_delay_ms / 1000,
        "sensor_delay": arm.dynamics.sensor_delay_ms / 1000,
        "sensor_noise": arm.dynamics.sensor_noise_rad,
        "encoder_step": arm.dynamics.encoder_step_rad,
    }


def _cloth_addresses(model: mujoco.MjModel, config: RecordConfig, item: ObjectConfig) -> ClothAddresses:
    cloth, name = item.cloth, item.name
    assert cloth is not None  # only called for cloth
    rest = flat_points(cloth)
    prefixes = [config.rig.arms[number].prefix for number in config.rig.recording_order]
    joints = [[model.joint(f"{name}_{k}_{axis}") for axis in "xyz"] for k in range(len(rest))]
    return ClothAddresses(
        flex=int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_FLEX, name)),
        grid=cloth.grid,
        flat_points=rest,
        qpos=np.array([[joint.qposadr[0] for joint in axes] for axes in joints]),
        dof=np.array([[joint.dofadr[0] for joint in axes] for axes in joints]),
        constraints=np.array(
            [
                [model.equality(cloth_grasp_constraint_name(prefix, name, k)).id for k in range(len(rest))]
                for prefix in prefixes
            ]
        ),
        half_thickness=cloth.half_thickness,
        max_point_spacing=cloth.max_point_spacing,
        held_by_layers=cloth.held == "layers",
        is_released_clear=cloth.release == "clear",
    )


def _finger_addresses(model: mujoco.MjModel, arm: ArmConfig, fingers: Fingers) -> FingerAddresses:
    drive, joints = model.actuator(arm.prefix + fingers.drive), [model.joint(arm.prefix + j) for j in fingers.joints]
    return FingerAddresses(
        qpos=np.array([joint.qposadr[0] for joint in joints]),
        dof=np.array([joint.dofadr[0] for joint in joints]),
        sign=np.array(arm.robot.finger_signs),
        ctrl=drive.id,
        gain=float(drive.gainprm[0]),
        ctrl_range=drive.ctrlrange.copy(),
        opening_limits=fingers.range,
        full_opening=fingers.full_opening,
    )


def _subtree_bodies(model: mujoco.MjModel, body: int) -> list[int]:
    """MuJoCo numbers parents before their children."""
    found = [body]
    for other in range(body + 1, model.nbody):
        if model.body_parentid[other] in found:
            found.append(other)
    return found


def _geom_owners(model: mujoco.MjModel, rig: RigConfig) -> tuple[Ids, Ids]:
    """Return `geom_kind` (without the table) and `geom_arm` of a `CompiledScene`, both (ngeom,)."""
    kind = np.full(model.nbody, int(GeomOwnerKind.OTHER))
    of_arm = np.full(model.nbody, -1)
    for k, number in enumerate(rig.recording_order):
        prefix, robot = rig.arms[number].prefix, rig.arms[number].robot
        on_arm = model.body_rootid == model.body(prefix + robot.base).id
        kind[on_arm], of_arm[on_arm] = GeomOwnerKind.ARM, k
        if robot.fingers is not None:
            for name, finger in zip(
                robot.fingers.bodies, (GeomOwnerKind.LEFT_FINGER, GeomOwnerKind.RIGHT_FINGER), strict=True
            ):
                kind[_subtree_bodies(model, model.body(prefix + name).id)] = finger
    kinds: Ids = kind[model.geom_bodyid]
    arms: Ids = of_arm[model.geom_bodyid]
    return kinds, arms
