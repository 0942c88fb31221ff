from __future__ import annotations

import copy
import functools
import re
from collections.abc import Iterable
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..config.rig import ArmConfig
from ..errors import ConfigError, ResourceError
from ..files.resources import MeshFolders
from ..geometry.se3 import Array
from ..robots.models import ArmModel, Gripper
from ..robots.robot import Robot
from .compilation import compile_spec

_VISIBLE_GEOM_GROUP = 2  # geom group that viewers show by default; collision geoms are in group 3


def _load_spec(arm: ArmConfig) -> mujoco.MjSpec:
    _require_compiles(arm.robot.xml, arm.model, arm.gripper)
    spec = mujoco.MjSpec.from_string(arm.robot.xml)
    if arm.grasp_offset is not None:
        spec.site("grasp_site").pos[2] = arm.grasp_offset
    return spec


@functools.lru_cache(maxsize=64)
def _require_compiles(xml: str, arm: ArmModel, gripper: Gripper) -> None:
    for mjcf in (arm.mjcf, gripper.mjcf):
        try:
            mujoco.MjSpec.from_string(mjcf.text)
        except ValueError as error:
            raise ConfigError(f"{mjcf.file} does not compile: {_error_text(error, lines=not mjcf.includes)}") from error
    both = f"{arm.mjcf.file} with {gripper.mjcf.file}"
    try:
        spec = mujoco.MjSpec.from_string(xml)
    except ValueError as error:
        raise ConfigError(f"{both} does not compile: {_error_text(error, lines=False)}") from error
    compile_spec(show_meshes_or_primitives(spec, (*arm.mesh_sets, *gripper.mesh_sets), None), both, ConfigError)


def _error_text(error: ValueError, *, lines: bool) -> str:
    """Unless `lines`, strip line numbers, which are wrong for combined files."""
    reason = " ".join(str(error).split())
    return reason if lines else re.sub(r",? line \d+", "", reason)


def arm_spec(arm: ArmConfig, meshes: MeshFolders | None) -> mujoco.MjSpec:
    """Return an arm with its gripper; its collision primitives are visible unless `meshes` has all its mesh sets."""
    if meshes is None:
        return _spec_with_primitives(arm).copy()
    return show_meshes_or_primitives(_load_spec(arm), arm.robot.mesh_sets, meshes)


# Deleting elements of a spec takes 8 ms, a copy 0.1 ms.
@functools.lru_cache(maxsize=64)
def _spec_with_primitives(arm: ArmConfig) -> mujoco.MjSpec:
    return show_meshes_or_primitives(_load_spec(arm), arm.robot.mesh_sets, None)


def show_meshes_or_primitives(spec: mujoco.MjSpec, sets: Iterable[str], meshes: MeshFolders | None) -> mujoco.MjSpec:
    """Show the visual meshes of a spec if `meshes` has a folder for all `sets`, else its collision primitives.

    A body without visual meshes always shows its primitives. The function changes and returns `spec`.
    """
    folders = {name: (meshes or {}).get(name) for name in sets}
    if all(folders.values()):
        files: dict[str, bytes] = {}
        for mesh in spec.meshes:
            assets, _, file = mesh.file.partition("/")
            folder = folders[assets]
            assert folder is not None
            mesh.file = f"meshes/{assets}/{file}"
            files[mesh.file] = read_mesh_file(folder / file)
        spec.assets = files
        for body in spec.bodies:
            if all(geom.group > _VISIBLE_GEOM_GROUP for geom in body.geoms):
                for geom in body.geoms:
                    geom.group = _VISIBLE_GEOM_GROUP
        return spec
    for body in spec.bodies:
        for geom in list(body.geoms):
            if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
                spec.delete(geom)
            else:
                geom.group = _VISIBLE_GEOM_GROUP
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    return spec


def read_mesh_file(path: Path) -> bytes:
    """Return the content of a mesh file, or raise `ResourceError`."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise ResourceError(
            f"the mesh {path} cannot be read ({error.strerror}): run `yamsim assets fetch`, or `yamsim assets "
            "import` for your own mesh"
        ) from error


def kinematic_model(arm: ArmConfig) -> mujoco.MjModel:
    """Return a model of the arm's joints and links in the base frame, without fingers, geoms and drives.

    It has all sites of the arm, and the site `tool` on the flange, which inverse kinematics moves.
    """
    return copy.copy(_compile_kinematics(arm))


@functools.lru_cache(maxsize=64)
def _compile_kinematics(arm: ArmConfig) -> mujoco.MjModel:
    robot = arm.robot
    spec = _load_spec(arm)
    for parts in (spec.equalities, spec.actuators, spec.sensors, spec.tendons, spec.excludes):
        for part in list(parts):
            spec.delete(part)
    flange = spec.body(robot.flange)
    moving = [joint.parent for joint in spec.joints if joint.name not in robot.joint_names]
    for body in flange.bodies:
        if any(_is_in(part, body) for part in moving):
            spec.delete(body)
    for body in spec.bodies:
        for geom in list(body.geoms):
            spec.delete(geom)
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    spec.body(robot.flange).add_site(name="tool")
    model = spec.compile()
    # MuJoCo marks the site as coincident with its body, and would ignore later changes of its pose.
    model.site_sameframe[model.site("tool").id] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
    return model


def finger_addresses(model: mujoco.MjModel, robot: Robot, prefix: str = "") -> tuple[NDArray[np.int_], Array]:
    """Return the finger joints' indices (2,) in `qpos`, and the sign (2,) of opening; (0,) without fingers."""
    if robot.fingers is None:
        return np.zeros(0, int), np.zeros(0)
    addresses = np.array([model.joint(prefix + name).qposadr[0] for name in robot.fingers.joints])
    return addresses, np.array(robot.finger_signs)


def _is_in(body: mujoco.MjsBody, other: mujoco.MjsBody) -> bool:
    while body is not None and body.name != "world":
        if body.name == other.name:
            return True
        body = body.parent
    return False
