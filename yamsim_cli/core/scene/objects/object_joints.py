from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from ...config.objects.articulation import Detent, Handle, Link, LinkJoint
from ...geometry.se3 import Array, pose, quat_from_rotation, rotation_from_vector
from .object_geoms import HIDDEN_GROUP

_DETENT_RADIUS = 0.05  # m, of a hinge's detent; any radius gives the same torque
_MAX_LENGTH = 10.0  # m, upper spring length; longer than any detent's spring becomes, so that the spring never pulls
_DETENT_TABLE_SIZE = 400  # joint positions at which a detent's force is computed
_THREAD_SOLREF = (0.004, 1.0)  # the stiffest one that a time step of 2 ms allows
# Of `stiff_friction`; the time constant is two steps of 2.1 ms. By default, a cap turns at 0.3 rad/s under less than
# half of its torque.
_STIFF_FRICTION_SOLREF = (0.0042, 1.0)
_STIFF_FRICTION_SOLIMP = (0.999, 0.999, 0.001, 0.5, 2.0)
_FRICTION_SOLIMP = (0.99, 0.999, 0.001, 0.5, 2.0)  # with the default, joints creep by mm a second


def joint_transform(joint: LinkJoint, value: float) -> Array:
    """Return a part's pose at joint position `value`, m or rad, in its frame at position 0."""
    axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
    if not joint.is_revolute:
        return pose(value * axis)
    turn = pose((0, 0, 0), rotation_from_vector(value * axis))
    lift = pose((joint.pitch or 0.0) * value / (2 * math.pi) * axis)
    moved: Array = lift @ pose(joint.position) @ turn @ pose(-np.array(joint.position))
    return moved


def link_start_pose(link: Link) -> Array:
    """Return a part's pose in its parent at the joint's start position."""
    T: Array = link.T_in_parent @ joint_transform(link.joint, link.joint.to_si(link.joint.start))
    return T


def add_link_joint(spec: mujoco.MjSpec, parent: Any, body: Any, name: str, link: Link) -> None:
    """Add the joint `name` of a moving part, with the thread of a screw joint and the springs of detents."""
    joint = link.joint
    start = joint.to_si(joint.start)
    rubs: dict[str, Any] = {
        "damping": [joint.damping, 0, 0], "frictionloss": joint.friction, "armature": joint.armature,
    }  # fmt: skip
    rubs["solimp_friction"] = _STIFF_FRICTION_SOLIMP if joint.stiff_friction else _FRICTION_SOLIMP
    if joint.stiff_friction:
        rubs["solref_friction"] = _STIFF_FRICTION_SOLREF
    if joint.type == "screw":
        assert joint.pitch is not None  # checked with the config
        lead = joint.pitch / (2 * math.pi)
        body.add_joint(
            name=f"{name}_thread", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=joint.axis, pos=joint.position,
            ref=lead * start,
        )  # fmt: skip
        spec.add_equality(
            name=f"{name}_thread",
            type=mujoco.mjtEq.mjEQ_JOINT,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            # The rotation follows the lift. The softness of an equality depends on the inertias of its joints. In the
            # opposite direction, a cap with its small rotational inertia would sag by centimetres.
            name1=name,
            name2=f"{name}_thread",
            data=[0, 1 / lead, *[0] * 10],
            solref=_THREAD_SOLREF,
        )
    body.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_HINGE if joint.is_revolute else mujoco.mjtJoint.mjJNT_SLIDE,
        axis=joint.axis,
        pos=joint.position,
        # With the compiler's angles in degrees, ranges are in degrees.
        range=[_joint_position(spec, joint, end) for end in joint.range],
        limited=True,
        ref=_joint_position(spec, joint, joint.start),
        **rubs,
    )
    for k, detent in enumerate(joint.detents):
        _add_detent(spec, parent, body, f"{name}_detent_{k}", link, detent)


def _joint_position(spec: mujoco.MjSpec, joint: LinkJoint, value: float) -> float:
    return value if joint.is_revolute and spec.compiler.degree else joint.to_si(value)


def _add_detent(spec: mujoco.MjSpec, parent: Any, body: Any, name: str, link: Link, detent: Detent) -> None:
    """Add a spring that the part compresses when it moves over the detent, and that is slack elsewhere.

    One end is on the part. The other end is on the parent, beside the path of the first end.
    """
    joint = link.joint
    axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    at, half = joint.to_si(detent.at), joint.to_si(detent.width) / 2
    on_part = np.array(joint.position) + (_DETENT_RADIUS * across if joint.is_revolute else 0.0)
    foot = 2 * _DETENT_RADIUS * math.sin(min(half, math.pi) / 2) if joint.is_revolute else half
    offset = foot * (axis if joint.is_revolute else across)
    T = link.T_in_parent @ joint_transform(joint, at)
    body.add_site(name=f"{name}_part", pos=on_part, group=HIDDEN_GROUP)
    parent.add_site(name=f"{name}_parent", pos=(T @ [*(on_part + offset), 1.0])[:3], group=HIDDEN_GROUP)
    path = np.linspace(0, half, _DETENT_TABLE_SIZE)
    chord = 2 * _DETENT_RADIUS * np.sin(path / 2) if joint.is_revolute else path
    length, rest = np.hypot(foot, chord), math.hypot(foot, foot)
    push = (rest - length) * np.gradient(length, path)
    tendon = spec.add_tendon(name=name, springlength=[rest, _MAX_LENGTH], group=HIDDEN_GROUP, rgba=[0, 0, 0, 0])
    tendon.stiffness = [detent.effort / float(push.max()), 0, 0]
    tendon.wrap_site(f"{name}_part")
    tendon.wrap_site(f"{name}_parent")


def add_handles(body: Any, name: str, handles: Sequence[Handle]) -> None:
    """Add each handle as a site `<name>_<handle>`: the target of the frame between the finger pads in a grasp."""
    for handle in handles:
        T = handle.T_pinch_in_part
        body.add_site(
            name=f"{name}_{handle.name}", pos=T[:3, 3], quat=quat_from_rotation(T[:3, :3]), group=HIDDEN_GROUP
        )
