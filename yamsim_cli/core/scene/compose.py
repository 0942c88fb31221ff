from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from ..config.randomization import ArmRanges
from ..config.rendering import SHADOW_REACH
from ..config.rig import ArmConfig, RigCamera, RigConfig
from ..files.resources import Locations, MeshFolders
from ..geometry.se3 import Array, quat_from_rotation
from ..robots.dynamics import MeasuredArmDynamics
from .arm_model import arm_spec, show_meshes_or_primitives
from .assets import AssetStore, resolve_user_set
from .blueprint import Blueprint, TaskPhysics
from .cameras import add_camera
from .cloth import add_cloth_grasp_constraints, set_cloth_options
from .compilation import compile_spec
from .environment import add_background, add_lights, add_table, apply_quality
from .fiducials import add_base_board
from .objects.scene_object import add_object
from .randomized_model import add_randomized_parts

_LINEAR_INTERPOLATION = 1  # MuJoCo's code for linear interpolation of delayed commands and readings
READING_SUFFIX = "_reading"  # suffix of a joint's name that gives the name of its delayed sensor
WELD_NAME = "grasp_weld"  # name, after the arm's prefix, of the weld by which the hand can hold an object


def visual_mesh_sets(blueprint: Blueprint) -> tuple[str, ...]:
    """Return the names of the asset sets with a scene's visual meshes."""
    things = (*blueprint.objects, *blueprint.randomization.distractor_configs)
    return tuple(sorted({*rig_mesh_sets(blueprint.rig), *(name for item in things for name in item.mesh_sets)}))


def rig_mesh_sets(rig: RigConfig) -> tuple[str, ...]:
    """Return the names of the asset sets with a rig's visual meshes."""
    robots = {name for arm in rig.arms for name in arm.robot.mesh_sets}
    return tuple(sorted(robots | {name for camera in rig.cameras for name in camera.mesh_sets}))


def _all_mesh_folders(locations: Locations, blueprint: Blueprint) -> MeshFolders:
    """Return the folders of the visual mesh sets, and of all sets of collision meshes, which physics needs."""
    things = (*blueprint.objects, *blueprint.randomization.distractor_configs)
    needed = {item.mesh.set for item in things if item.needs_meshes and locations.meshes.get(item.mesh.set) is None}
    store = AssetStore(locations.assets)
    return {**locations.meshes, **{name: resolve_user_set(store, name) for name in sorted(needed)}}


def compose_scene(blueprint: Blueprint, locations: Locations) -> mujoco.MjSpec:
    """Return the spec of a scene. All names of an arm begin with its prefix, which may be empty."""
    rig, meshes = blueprint.rig, _all_mesh_folders(locations, blueprint)
    bases = [rig.T_base_in_world(k) for k in range(len(rig.arms))]
    spec = _compose_arms(rig, bases, locations, meshes)
    spec.modelname = blueprint.name or rig.name
    spec.compiler.autolimits = True
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    if blueprint.boards:
        for arm, T in zip(rig.arms, bases, strict=True):
            add_base_board(spec, arm, T)
    for item in blueprint.objects:
        add_object(spec, item, meshes)
        if item.cloth is not None:
            set_cloth_options(spec, item.cloth)
            add_cloth_grasp_constraints(spec, item, rig)
    _add_surroundings(spec, blueprint, bases)
    add_randomized_parts(spec, blueprint.randomization, meshes)
    if blueprint.pictures is not None:
        apply_quality(spec, blueprint.pictures.quality, blueprint.pictures.size)
    if blueprint.physics is not None:
        _add_physics(spec, blueprint.physics, rig, blueprint.randomization.arm_dynamics)
    for camera in blueprint.cameras:
        add_camera(spec, camera)
    return spec


def _add_surroundings(spec: mujoco.MjSpec, blueprint: Blueprint, bases: Sequence[Array]) -> None:
    scene = blueprint.scene
    centre = np.mean([T[:3, 3] for T in bases], axis=0)
    middle = np.mean([centre, scene.table.position], axis=0) if scene.table else centre
    if blueprint.background:
        add_background(spec, scene)
        add_lights(spec, scene, middle)
    if scene.table:
        add_table(spec, scene.table, scene.safety_plane, bases)
    visual = spec.visual
    # With fixed values, no object changes the clip planes or the resolution of the shadow map.
    spec.stat.extent = 1.0
    spec.stat.center = middle
    visual.map.znear = 0.01
    visual.map.zfar = 20.0
    # A smaller clip sharpens shadows. Objects farther away cast no shadows.
    visual.map.shadowclip = SHADOW_REACH + max(float(np.linalg.norm(T[:3, 3] - centre)) for T in bases)
    # Directional lights illuminate a flat face evenly, so one quad suffices.
    visual.quality.numquads = 1


def set_friction_cones(spec: mujoco.MjSpec, impratio: float = 10.0) -> None:
    """Set elliptic friction cones and `impratio`, so that two pads hold an object by friction.

    Source: MuJoCo's documentation of `impratio`, which recommends elliptic cones.
    """
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = impratio


def _add_delays(spec: mujoco.MjSpec, arm: ArmConfig, timestep: float, ranges: ArmRanges | None) -> None:
    """Add the longest delays of an arm's drives and encoders, which `RandomizedArms` shortens."""
    own = arm.dynamics or MeasuredArmDynamics(revision=arm.name, base=arm.model.name)
    most, robot = ranges or ArmRanges(), arm.robot
    if delay := (own.command_delay_ms + most.command_delay_ms[1]) / 1000:
        for name in robot.drive_names:
            drive = spec.actuator(arm.prefix + name)
            # A delay may not be a whole number of steps.
            drive.delay, drive.nsample, drive.interp = delay, math.ceil(delay / timestep) + 2, _LINEAR_INTERPOLATION
    if delay := (own.sensor_delay_ms + most.sensor_delay_ms[1]) / 1000:
        for name in (*robot.joint_names, *(robot.fingers.joints[:1] if robot.fingers else ())):
            spec.add_sensor(
                name=arm.prefix + name + READING_SUFFIX,
                type=mujoco.mjtSensor.mjSENS_JOINTPOS,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                objname=arm.prefix + name,
                delay=delay,
                nsample=math.ceil(delay / timestep) + 2,
                interp=_LINEAR_INTERPOLATION,
            )


def _add_physics(spec: mujoco.MjSpec, physics: TaskPhysics, rig: RigConfig, ranges: ArmRanges | None) -> None:
    spec.option.timestep = physics.timestep
    if physics.impratio is not None:
        set_friction_cones(spec, physics.impratio)
    for arm in rig.arms:
        _add_delays(spec, arm, physics.timestep, ranges)
    for arm in rig.arms if physics.weld_placeholder is not None else ():
        spec.add_equality(
            name=arm.prefix + WELD_NAME,
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1=arm.prefix + arm.robot.flange,
            name2=physics.weld_placeholder,
            active=False,
        )


def _compose_arms(rig: RigConfig, bases: Sequence[Array], locations: Locations, meshes: MeshFolders) -> mujoco.MjSpec:
    """An arm without a prefix is the root, because MuJoCo attaches only with a prefix."""
    specs = [arm_spec(arm, meshes) for arm in rig.arms]
    root = mujoco.MjSpec()
    for arm, child, T in zip(rig.arms, specs, bases, strict=True):
        if not arm.prefix:
            root = child
            base = root.body(arm.robot.base)
            base.pos, base.quat = T[:3, 3], quat_from_rotation(T[:3, :3])
    for arm, child, T in zip(rig.arms, specs, bases, strict=True):
        if arm.prefix:
            frame = root.worldbody.add_frame(pos=T[:3, 3], quat=quat_from_rotation(T[:3, :3]))
            root.attach(child, frame=frame, prefix=arm.prefix)
    for camera in rig.cameras:
        if camera.housing:
            _add_housing(root, rig, camera, locations, meshes)
    _share_files(root)
    return root


def _add_housing(
    root: mujoco.MjSpec, rig: RigConfig, camera: RigCamera, locations: Locations, meshes: MeshFolders
) -> None:
    file = locations.find_data_file(f"robot_models/cameras/{camera.housing}.xml")
    child = show_meshes_or_primitives(mujoco.MjSpec.from_file(str(file)), camera.mesh_sets, meshes)
    T = rig.T_cam_in_world(camera)
    frame = root.worldbody.add_frame(pos=T[:3, 3], quat=quat_from_rotation(T[:3, :3]))
    root.attach(child, frame=frame, prefix=f"{camera.name}_")


def _share_files(spec: mujoco.MjSpec) -> None:
    """Let equal mesh files of several arms share one asset. Attaching an arm has renamed the arm's copies."""
    first: dict[tuple[str, bytes], str] = {}
    shared = {name: first.setdefault((name.rpartition("/")[0], data), name) for name, data in spec.assets.items()}
    for mesh in spec.meshes:
        mesh.file = shared.get(mesh.file, mesh.file)


def add_home_key(
    spec: mujoco.MjSpec,
    rig: RigConfig,
    start: Mapping[str, Array],
    joints: Sequence[Sequence[float]] | None = None,
    parts: Mapping[str, float] | None = None,
) -> mujoco.MjModel:
    """Add a keyframe `home`, in which the drives hold the arms at rest, and return the compiled model.

    Args:
        start: object -> pose in `world`, also in the model's default state.
        joints: (dof,) of each arm, rad; by default the robots' home.
        parts: joint of an articulated object -> position, m or rad.
    """
    for name, T in start.items():
        body = spec.body(name)
        body.pos, body.quat = T[:3, 3], quat_from_rotation(T[:3, :3])
    model = compile_spec(spec)
    qpos, ctrl = model.qpos0.copy(), np.zeros(model.nu)
    resting = [arm.robot.home for arm in rig.arms] if joints is None else joints
    for arm, angles in zip(rig.arms, resting, strict=True):
        for name, angle in zip(arm.robot.joint_names, angles, strict=True):
            qpos[model.joint(arm.prefix + name).qposadr[0]] = angle
    for name, position in (parts or {}).items():
        qpos[model.joint(name).qposadr[0]] = position
    load = _static_joint_torques(model, qpos)
    for arm, angles in zip(rig.arms, resting, strict=True):
        for name, moved, angle in zip(arm.robot.joint_drives, arm.robot.joint_names, angles, strict=True):
            drive = model.actuator(arm.prefix + name)
            # Uncompensated loads, such as a wrist camera, would displace the drives by milliradians. The commands
            # compensate for this, rounded to a nanoradian.
            offset = round(load[model.joint(arm.prefix + moved).dofadr[0]] / drive.gainprm[0], 9)
            ctrl[drive.id] = np.clip(angle + offset, *drive.ctrlrange)
    spec.add_key(name="home", qpos=qpos, ctrl=ctrl)
    return compile_spec(spec)


def _static_joint_torques(model: mujoco.MjModel, qpos: Array) -> Array:
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    bearing: Array = data.qfrc_bias - data.qfrc_passive
    return bearing
