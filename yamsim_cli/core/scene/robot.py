"""The arm as MuJoCo knows it, on its two paths that must not be confused: whole for scenes, bare for kinematics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..config.rig import ArmConfig
from ..errors import ResourceError
from ..geometry.se3 import Array
from ..resources import Locations

JOINTS = ("joint1", "joint2", "joint3", "joint4", "joint5", "joint6")
FINGER_JOINTS = ("left_finger", "right_finger")
ACTUATORS = (*JOINTS, "gripper")
FINGERS = ("link_left_finger", "link_right_finger")

# Asset set -> folder of its files, or None where they are not here.
Meshes = Mapping[str, Path | None]

# The arms' resting joints. Source: MuJoCo Menagerie i2rt_yam, keyframe `home`.
HOME = (0.0, 1.047, 1.047, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Gripper:
    """What is not in a gripper's MJCF.

    Attributes:
        mesh_sets: the asset sets that its MJCF takes meshes from, the arm's own links included.
        full_opening: of one finger, m.
    """

    mesh_sets: tuple[str, ...]
    full_opening: float


# By model and gripper. Source of the openings: MuJoCo Menagerie i2rt_yam and yam_linear_4310, `left_finger` range.
GRIPPERS = {
    ("i2rt_yam", "crank"): Gripper(("i2rt_yam_crank",), 0.0375),
    ("i2rt_yam", "linear_4310"): Gripper(("i2rt_yam_crank", "i2rt_yam_linear_4310"), 0.0475),
}

# Geom groups: what a viewer shows by default (2) and what it hides (3).
_SEEN_GROUP = 2


def gripper(arm: ArmConfig) -> Gripper:
    """What there is to know of an arm's gripper."""
    return GRIPPERS[arm.model, arm.gripper]


def _load(arm: ArmConfig, locations: Locations) -> mujoco.MjSpec:
    spec = mujoco.MjSpec.from_file(str(locations.file(f"robot_models/{arm.model}/yam_{arm.gripper}.xml")))
    if arm.grasp_offset is not None:
        spec.site("grasp_site").pos[2] = arm.grasp_offset
    # A keyframe only fits the model it was written for; whoever composes a scene writes the scene's own.
    for key in list(spec.keys):
        spec.delete(key)
    return spec


def arm_spec(arm: ArmConfig, locations: Locations, meshes: Meshes | None) -> mujoco.MjSpec:
    """The whole arm, for scenes.

    Args:
        meshes: the visual meshes; without all of the arm's, the collision primitives are shown instead, with the same
            physics.
    """
    spec = _load(arm, locations)
    folders = {name: (meshes or {}).get(name) for name in gripper(arm).mesh_sets}
    if all(folders.values()):
        files: dict[str, bytes] = {}
        for mesh in spec.meshes:
            assets, _, file = mesh.file.partition("/")
            folder = folders[assets]
            assert folder is not None
            mesh.file = f"meshes/{assets}/{file}"
            files[mesh.file] = mesh_bytes(folder / file)
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


def mesh_bytes(path: Path) -> bytes:
    """A mesh's file.

    Raises:
        ResourceError: it cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise ResourceError(
            f"the mesh {path} cannot be read ({error.strerror}): `yamsim assets fetch` brings it, or `yamsim assets "
            "import` if it is your own"
        ) from error


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


def fingers(model: mujoco.MjModel, prefix: str = "") -> tuple[NDArray[np.int_], Array]:
    """Where an arm's two fingers are in `qpos` (2,), and what each is there when both are open by 1 m (2,).

    Some grippers' models count both openings up, some count the right finger's down.
    """
    addresses = np.array([model.joint(prefix + name).qposadr[0] for name in FINGER_JOINTS])
    # The coupling says: left = factor x right.
    factor = float(model.eq_data[model.equality(f"{prefix}finger_coupling").id, 1])
    return addresses, np.array([1.0, 1.0 / factor])
