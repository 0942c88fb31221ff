"""Any rig as one MjSpec: arms, base boards, mounts, and what stands around them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from ..config.objects import ObjectConfig
from ..config.record import SHADOW_REACH
from ..config.rig import RigConfig
from ..config.scene import SceneConfig
from ..errors import SimulationError
from ..geometry.se3 import Array, quat_from_rotation
from ..resources import Locations
from .breakdown import keep_warnings_quiet
from .fiducials import add_base_board
from .objects import add_object
from .robot import HOME, JOINTS, arm_spec, gripper
from .robot import Meshes as Meshes
from .surroundings import add_background, add_lights, add_table


@dataclass(frozen=True)
class Contents:
    """What a composed scene is to hold beside its arms.

    Attributes:
        boards: base boards and mounts.
        background: sky, floor and lights; without it, MuJoCo's headlight is left as it is. A table belongs to the
            task and stays.
        objects: free bodies to be added, for a task.
    """

    boards: bool = True
    background: bool = True
    objects: tuple[ObjectConfig, ...] = ()


def mesh_sets(rig: RigConfig, objects: Sequence[ObjectConfig] = ()) -> tuple[str, ...]:
    """Names of the asset sets whose meshes a scene shows."""
    robots = {name for arm in rig.arms for name in gripper(arm).mesh_sets}
    return tuple(sorted(robots | {item.mesh.set for item in objects}))


def compose(
    rig: RigConfig, scene: SceneConfig, contents: Contents, locations: Locations, meshes: Meshes
) -> mujoco.MjSpec:
    """Put a rig together.

    The first arm's names stay as its model has them where its prefix is empty; another arm's carry its prefix.

    Args:
        locations: where the robot models are.
        meshes: asset set -> folder of its files, or None to show primitives.

    Raises:
        ConfigError: a mount's STL cannot be read, or a board's dictionary does not exist.
    """
    bases = [rig.T_base_in_world(k) for k in range(len(rig.arms))]
    spec = _arms(rig, bases, locations, meshes)
    spec.modelname = rig.name
    spec.compiler.autolimits = True
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    if contents.boards:
        for arm, T in zip(rig.arms, bases, strict=True):
            add_base_board(spec, arm, T)
    for item in contents.objects:
        add_object(spec, item, meshes.get(item.mesh.set))
    stand = np.mean([T[:3, 3] for T in bases], axis=0)
    middle = np.mean([stand, scene.table.position], axis=0) if scene.table else stand
    if contents.background:
        add_background(spec, scene)
        add_lights(spec, scene, middle)
    if scene.table:
        add_table(spec, scene.table, scene.safety_plane, bases)
    visual = spec.visual
    # Fixed rather than fitted to the model, so that no object changes the clip planes or the shadow map's resolution.
    spec.stat.extent = 1.0
    spec.stat.center = middle
    visual.map.znear = 0.01
    visual.map.zfar = 20.0
    # The tighter, the sharper the shadows; what stands farther off casts none.
    visual.map.shadowclip = SHADOW_REACH + max(float(np.linalg.norm(T[:3, 3] - stand)) for T in bases)
    # Lights are directional, so a flat face is lit evenly, and cutting it up gives nothing.
    visual.quality.numquads = 1
    return spec


def _arms(rig: RigConfig, bases: Sequence[Array], locations: Locations, meshes: Meshes) -> mujoco.MjSpec:
    """All arms in one spec: the one without a prefix is its root, since attaching would need one."""
    specs = [arm_spec(arm, locations, meshes) for arm in rig.arms]
    root = mujoco.MjSpec()
    for arm, child, T in zip(rig.arms, specs, bases, strict=True):
        if not arm.prefix:
            root = child
            root.body("arm").pos, root.body("arm").quat = T[:3, 3], quat_from_rotation(T[:3, :3])
    for arm, child, T in zip(rig.arms, specs, bases, strict=True):
        if arm.prefix:
            frame = root.worldbody.add_frame(pos=T[:3, 3], quat=quat_from_rotation(T[:3, :3]))
            root.attach(child, frame=frame, prefix=arm.prefix)
    _share_files(root)
    return root


def _share_files(spec: mujoco.MjSpec) -> None:
    """Let arms with the same meshes use the same files of a set: attaching renames each arm's own copy."""
    first: dict[tuple[str, bytes], str] = {}
    shared = {name: first.setdefault((name.rpartition("/")[0], data), name) for name, data in spec.assets.items()}
    for mesh in spec.meshes:
        mesh.file = shared.get(mesh.file, mesh.file)


def compile_spec(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a composed scene.

    Raises:
        SimulationError: MuJoCo refused it.
    """
    keep_warnings_quiet()
    try:
        return spec.compile()
    except ValueError as error:
        raise SimulationError(f"scene {spec.modelname!r} does not compile: {' '.join(str(error).split())}") from error


def add_home_key(
    spec: mujoco.MjSpec, rig: RigConfig, start: Mapping[str, Array], joints: Sequence[float] = HOME
) -> mujoco.MjModel:
    """Add a keyframe `home` of the composed model's size, in which the arms rest, and compile.

    Args:
        start: object -> pose (4, 4) in `world`, there and in the model's own reset.
        joints: of every arm (6,), rad.
    """
    for name, T in start.items():
        body = spec.body(name)
        body.pos, body.quat = T[:3, 3], quat_from_rotation(T[:3, :3])
    model = compile_spec(spec)
    qpos, ctrl = model.qpos0.copy(), np.zeros(model.nu)
    for arm in rig.arms:
        for name, angle in zip(JOINTS, joints, strict=True):
            qpos[model.joint(arm.prefix + name).qposadr[0]] = angle
    load = _load(model, qpos)
    for arm in rig.arms:
        for name, angle in zip(JOINTS, joints, strict=True):
            drive = model.actuator(arm.prefix + name)
            # A drive is a spring towards what it is told. What its arm's gravity compensation does not know of, such as
            # a camera on the wrist, would pull it off by some milliradians; finer than a nanoradian is rounding.
            lead = round(load[model.joint(arm.prefix + name).dofadr[0]] / drive.gainprm[0], 9)
            ctrl[drive.id] = np.clip(angle + lead, *drive.ctrlrange)
    spec.add_key(name="home", qpos=qpos, ctrl=ctrl)
    return compile_spec(spec)


def _load(model: mujoco.MjModel, qpos: Array) -> Array:
    """What the drives have to bear (nv,) at rest at `qpos`, N m and N."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    bearing: Array = data.qfrc_bias - data.qfrc_passive
    return bearing
