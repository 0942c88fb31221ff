"""The arm as MuJoCo knows it, on its two paths that must not be confused: whole for scenes, bare for kinematics."""

from __future__ import annotations

from pathlib import Path

import mujoco

from ..config.rig import ArmConfig
from ..resources import Locations

JOINTS = ("joint1", "joint2", "joint3", "joint4", "joint5", "joint6")
GRIPPER_JOINT = "left_finger"
ACTUATORS = (*JOINTS, "gripper")
FINGERS = ("link_left_finger", "link_right_finger")

# The arms' resting joints. Source: MuJoCo Menagerie i2rt_yam, keyframe `home`.
HOME = (0.0, 1.047, 1.047, 0.0, 0.0, 0.0)

# Asset set with the visual meshes of each (model, gripper).
MESH_SETS = {("i2rt_yam", "crank"): "i2rt_yam_crank"}

# Geom groups: what a viewer shows by default (2) and what it hides (3).
_SEEN_GROUP = 2


def _load(arm: ArmConfig, locations: Locations) -> mujoco.MjSpec:
    spec = mujoco.MjSpec.from_file(str(locations.file(f"robot_models/{arm.model}/yam_{arm.gripper}.xml")))
    if arm.grasp_offset is not None:
        spec.site("grasp_site").pos[2] = arm.grasp_offset
    # A keyframe only fits the model it was written for; whoever composes a scene writes the scene's own.
    for key in list(spec.keys):
        spec.delete(key)
    return spec


def arm_spec(arm: ArmConfig, locations: Locations, meshes: Path | None) -> mujoco.MjSpec:
    """The whole arm, for scenes.

    Args:
        meshes: folder with the visual meshes; None shows the collision primitives instead, with the same physics.
    """
    spec = _load(arm, locations)
    if meshes is not None:
        files: dict[str, bytes] = {}
        for mesh in spec.meshes:
            name = f"meshes/{MESH_SETS[arm.model, arm.gripper]}/{mesh.file}"
            files[name] = (meshes / mesh.file).read_bytes()
            mesh.file = name
        spec.assets = files
        return spec
    for body in spec.bodies:
        for geom in list(body.geoms):
            if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
                spec.delete(geom)
            else:
                geom.group = _SEEN_GROUP
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    return spec


def bare_arm(arm: ArmConfig, locations: Locations) -> mujoco.MjModel:
    """The arm's kinematics alone: six joints in the base frame `arm`, no fingers, no geoms, no drives; nq = 6.

    It has the model's sites, and a site `tool` on `link_6` that inverse kinematics places where it needs it.
    """
    spec = _load(arm, locations)
    for equality in list(spec.equalities):
        spec.delete(equality)
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for finger in FINGERS:
        spec.delete(spec.body(finger))
    for body in spec.bodies:
        for geom in list(body.geoms):
            spec.delete(geom)
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    spec.body("link_6").add_site(name="tool")
    model = spec.compile()
    # Compiled at its body's own frame, the site would be marked as coinciding with it, and MuJoCo would ignore where it
    # is moved to later.
    model.site_sameframe[model.site("tool").id] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
    return model
