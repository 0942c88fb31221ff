"""From configs to a compiled scene, by MjSpec: arm, table, objects, weld, cameras, lights, safety plane."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np

from ..config.record import RecordConfig
from ..config.rig import ArmConfig
from ..config.scene import FixedCamera, SceneConfig
from ..errors import SimulationError
from ..geometry.camera import opencv_from_mujoco
from ..geometry.se3 import Array, quat_from_rotation
from ..resources import Locations
from .compiled import CompiledScene
from .objects import SEEN_GROUP, add_object
from .robot import ACTUATORS, GRIPPER_JOINT, JOINTS, MESH_SETS, arm_spec

SCENE_CAMERA = "scene_camera"
WELD = "grasp_weld"


def mesh_sets(config: RecordConfig) -> tuple[str, ...]:
    """Names of the asset sets whose meshes a scene shows."""
    robots = {MESH_SETS[arm.model, arm.gripper] for arm in config.rig.arms}
    objects = {config.task.object.mesh.set, config.task.target.mesh.set}
    return tuple(sorted(robots | objects))


def build_scene(config: RecordConfig, locations: Locations, meshes: Mapping[str, Path | None]) -> CompiledScene:
    """Compose and compile the scene of a recording.

    Args:
        config: rig, surroundings, task, image size and render settings.
        locations: where the robot models are.
        meshes: asset set -> folder of its files, or None to show primitives.

    Raises:
        SimulationError: MuJoCo refused the composed model.
    """
    # The first arm's own spec is the scene's root, so that its names stay as its model has them, without a prefix.
    arm = config.rig.arms[0]
    spec = arm_spec(arm, locations, meshes.get(MESH_SETS[arm.model, arm.gripper]))
    spec.modelname = f"{config.rig.name}_{config.scene.name}_{config.task.name}"
    spec.compiler.autolimits = True
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.timestep = config.task.timing.timestep
    T = config.rig.T_base_in_world(0)
    spec.body("arm").pos = T[:3, 3]
    spec.body("arm").quat = quat_from_rotation(T[:3, :3])
    _visual(spec, config)
    _surroundings(spec, config.scene)
    for item in (config.task.object, config.task.target):
        add_object(spec, item, meshes.get(item.mesh.set))
    spec.add_equality(
        name=WELD,
        type=mujoco.mjtEq.mjEQ_WELD,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        name1="link_6",
        name2=config.task.object.name,
        active=False,
    )

    cameras = [SCENE_CAMERA]
    fixed = config.scene.scene_camera
    spec.worldbody.add_camera(
        name=SCENE_CAMERA, pos=fixed.position, quat=quat_from_rotation(_look_at(fixed)), fovy=fixed.fovy_deg
    )
    if config.wrist:
        _add_wrist_camera(spec, arm)
        cameras.append(arm.wrist_camera_name)
    try:
        model = spec.compile()
    except ValueError as error:
        raise SimulationError(
            f"the scene of rig {config.rig.name!r} does not compile: {' '.join(str(error).split())}"
        ) from error
    return _addresses(model, config, tuple(cameras))


def _visual(spec: mujoco.MjSpec, config: RecordConfig) -> None:
    width, height = config.image.size_px
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = width, height
    visual.quality.offsamples = config.render.multisamples
    visual.quality.shadowsize = config.render.shadow_map_px
    visual.headlight.ambient = config.scene.ambient
    visual.headlight.diffuse = (0.15, 0.15, 0.15)
    visual.headlight.specular = (0, 0, 0)
    # Fixed rather than fitted to the model, so that no object changes the clip planes or the shadow map's resolution.
    spec.stat.extent = 1.0
    spec.stat.center = config.scene.table.position
    visual.map.znear = 0.01
    visual.map.zfar = 20.0
    visual.map.shadowclip = 1.0


def _surroundings(spec: mujoco.MjSpec, scene: SceneConfig) -> None:
    floor = spec.add_texture(
        name="floor",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=scene.floor_rgba[0],
        rgb2=scene.floor_rgba[1],
        width=256,
        height=256,
    )
    material = spec.add_material(name="floor", texrepeat=[2, 2], texuniform=True, specular=0.1, shininess=0.1)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = floor.name
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=scene.sky[1],
        rgb2=scene.sky[0],
        width=64,
        height=64,
    )
    spec.worldbody.add_geom(
        name="safety_plane",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=[0, 0, scene.safety_plane],
        size=[5, 5, 0.1],
        material="floor",
        # What everything stands on would only cast dots of false shadow onto itself.
        castshadow=False,
    )
    spec.add_material(name="table", rgba=scene.table.rgba, specular=0.1, shininess=0.1)
    spec.worldbody.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=scene.table.position,
        size=scene.table.half_size,
        material="table",
        friction=scene.table.contact.friction,
        condim=scene.table.contact.condim,
        group=SEEN_GROUP,
        castshadow=False,
    )
    _add_legs(spec, scene)
    centre = np.asarray(scene.table.position)
    for k, light in enumerate(scene.lights):
        direction = np.asarray(light.direction) / np.linalg.norm(light.direction)
        spec.worldbody.add_light(
            name=f"light_{k}",
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            # A directional light's position only centres its shadow map.
            pos=centre - direction,
            dir=direction,
            diffuse=light.diffuse,
            specular=light.specular,
            castshadow=light.castshadow,
        )


def _add_legs(spec: mujoco.MjSpec, scene: SceneConfig) -> None:
    """Legs under the table and a post under the arm, down to the floor; only seen, never touched."""
    x, y, _ = scene.table.position
    half_x, half_y, _ = scene.table.half_size
    bottom = scene.table.top - 2 * scene.table.half_size[2]
    inset = 0.03
    posts = [(x + i * (half_x - inset), y + j * (half_y - inset), bottom, 0.02) for i in (-1, 1) for j in (-1, 1)]
    arm = spec.body("arm").pos
    posts.append((arm[0], arm[1], arm[2] - 0.001, 0.06))
    for k, (px, py, top, half) in enumerate(posts):
        height = top - scene.safety_plane
        spec.worldbody.add_geom(
            name=f"post_{k}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[px, py, top - height / 2],
            size=[half, half, height / 2],
            material="table",
            group=SEEN_GROUP,
            contype=0,
            conaffinity=0,
            castshadow=False,
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


def _add_wrist_camera(spec: mujoco.MjSpec, arm: ArmConfig) -> None:
    camera = arm.wrist_camera
    x = np.asarray(camera.x_axis) / np.linalg.norm(camera.x_axis)
    y = np.asarray(camera.y_axis) / np.linalg.norm(camera.y_axis)
    R = opencv_from_mujoco(np.column_stack([x, y, np.cross(x, y)]))
    spec.body("link_6").add_camera(
        name=arm.wrist_camera_name, pos=camera.position, quat=quat_from_rotation(R), fovy=camera.fovy_deg
    )


def _addresses(model: mujoco.MjModel, config: RecordConfig, cameras: tuple[str, ...]) -> CompiledScene:
    drives = [model.actuator(name).id for name in ACTUATORS]
    arm = np.array(drives[:6])
    objects = (config.task.object.name, config.task.target.name)
    return CompiledScene(
        model=model,
        joint_qpos=np.array([model.joint(name).qposadr[0] for name in JOINTS]),
        joint_dof=np.array([model.joint(name).dofadr[0] for name in JOINTS]),
        gripper_qpos=np.array([model.joint(name).qposadr[0] for name in (GRIPPER_JOINT, "right_finger")]),
        arm_ctrl=arm,
        gripper_ctrl=drives[6],
        kp=model.actuator_gainprm[arm, 0].copy(),
        kv=-model.actuator_biasprm[arm, 2],
        ctrl_range=model.actuator_ctrlrange[arm].copy(),
        weld=model.equality(WELD).id,
        object_qpos={name: int(model.joint(name).qposadr[0]) for name in objects},
        object_dof={name: int(model.joint(name).dofadr[0]) for name in objects},
        T_base_in_world=config.rig.T_base_in_world(0),
        cameras=cameras,
    )
