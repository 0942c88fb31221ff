from __future__ import annotations

import functools
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field

import numpy as np

from ..errors import ConfigError
from ..geometry.se3 import Array
from . import mjcf
from .dynamics import MeasuredArmDynamics
from .models import ArmModel, Fingers, Gripper, JointChange, JointLimits, find_gripper_fit


@dataclass(frozen=True)
class Robot:
    """An arm with its gripper.

    Attributes:
        xml: the merged MJCF of arm and gripper.
        base: the body whose frame is the arm's base frame.
        flange: the body that turns with the last joint, and carries the gripper.
        joints: from the base to the flange, with their limits for this gripper.
        joint_drives: the actuators of these joints.
        home, start: joint positions of the idle arm, and at the start of tasks without `start_joints`, rad.
        finger_signs: for the left and the right finger, 1 if its joint increases with the opening, else -1.
        mesh_sets: asset sets of the MJCF's meshes.
        T_base_mesh: pose, in the base frame, of the frame in which fiducial boards and mounts are given.
        dynamics: measured dynamics. `xml` already contains those that MJCF has an attribute for.
    """

    model: str
    gripper: str
    xml: str = field(repr=False)
    base: str
    flange: str
    joints: tuple[JointLimits, ...]
    joint_drives: tuple[str, ...]
    home: tuple[float, ...]
    start: tuple[float, ...]
    fingers: Fingers | None
    finger_signs: tuple[float, float]
    mesh_sets: tuple[str, ...]
    T_base_mesh: Array = field(repr=False, compare=False)
    dynamics: MeasuredArmDynamics | None = None

    @property
    def dof(self) -> int:
        """Joints, without fingers."""
        return len(self.joints)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints from the base to the flange."""
        return tuple(joint.name for joint in self.joints)

    @property
    def drive_names(self) -> tuple[str, ...]:
        """Names of the joints' drives, then of the fingers' drive."""
        return (*self.joint_drives, *((self.fingers.drive,) if self.fingers else ()))

    @property
    def joint_range(self) -> Array:
        """Joint limits (dof, 2), rad."""
        return np.array([joint.range for joint in self.joints])


@functools.lru_cache(maxsize=64)
def assemble_robot(arm: ArmModel, gripper: Gripper, dynamics: MeasuredArmDynamics | None = None) -> Robot:
    """Return an arm with a gripper mounted, and with measured `dynamics`.

    Raises:
        ValueError: the gripper does not fit the arm, or the dynamics belong to another arm.
        ConfigError: an MJCF lacks an element that its YAML names, or the two contradict each other.
    """
    how = find_gripper_fit(arm, gripper)
    root = mjcf.merge_gripper(arm, gripper, how)
    mjcf.find_body(root, arm.base, arm.mjcf)
    signs = _write_fingers(root, gripper) if gripper.fingers else (1.0, 1.0)
    root.set("model", f"{arm.name}_{gripper.name}")
    if dynamics is not None:
        dynamics.check(arm)
        mjcf.write_dynamics(root, arm, gripper, dynamics)
    ranges = {name: change.range for name, change in how.joints.items() if change.range}
    return Robot(
        model=arm.name,
        gripper=gripper.name,
        xml=ElementTree.tostring(root, encoding="unicode"),
        base=arm.base,
        flange=arm.flange,
        joints=tuple(joint.model_copy(update={"range": ranges.get(joint.name, joint.range)}) for joint in arm.joints),
        joint_drives=tuple(
            mjcf.find_position_drive(root, joint.name, arm.mjcf).get("name", "") for joint in arm.joints
        ),
        home=arm.home,
        start=arm.home if arm.start is None else arm.start,
        fingers=gripper.fingers,
        finger_signs=signs,
        mesh_sets=tuple(dict.fromkeys((*arm.mesh_sets, *gripper.mesh_sets))),
        T_base_mesh=arm.base_mesh.T,
        dynamics=dynamics,
    )


def widest_joint_limits(arm: ArmModel) -> tuple[JointLimits, ...]:
    """Return an arm's joints, each with its widest limits over all grippers in the arm's file."""

    def widest_range(joint: JointLimits) -> tuple[float, float]:
        changed = (how.joints.get(joint.name, JointChange()).range for how in arm.grippers.values())
        ranges = [joint.range, *(found for found in changed if found)]
        return min(low for low, _ in ranges), max(high for _, high in ranges)

    return tuple(joint.model_copy(update={"range": widest_range(joint)}) for joint in arm.joints)


def _write_fingers(root: ElementTree.Element, gripper: Gripper) -> tuple[float, float]:
    fingers = gripper.fingers
    assert fingers is not None
    drive = mjcf.find_position_drive(root, fingers.joints[0], gripper.mjcf)
    if drive.get("name") != fingers.drive:
        raise ConfigError(
            f"{gripper.mjcf.file}: the drive of {fingers.joints[0]!r} has the name {drive.get('name')!r}, "
            f"but gripper.yaml has {fingers.drive!r}"
        )
    left_for_right = mjcf.coupling_ratio(root, *fingers.joints)
    signs = (1.0, 1.0 / left_for_right)
    for name, body, sign in zip(fingers.joints, fingers.bodies, signs, strict=True):
        mjcf.find_body(root, body, gripper.mjcf)
        joint = mjcf.find_joint(root, name, gripper.mjcf)
        if "range" in joint.attrib:
            raise ConfigError(
                f"{gripper.mjcf.file}: joint {name!r} has a range; leave it out, because gripper.yaml gives it"
            )
        joint.set("range", mjcf.format_numbers(sorted(sign * end for end in fingers.range)))
    return signs
