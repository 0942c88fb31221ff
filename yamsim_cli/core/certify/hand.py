"""A hand without an arm: gripper linear_4310 on a base that is told where to go, and a thing in the air."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import mujoco
import numpy as np

from ..attempt.alone import RIG
from ..config.loader import load_config
from ..config.rig import ArmConfig, RigConfig
from ..geometry.se3 import Array, inverse, pose, pose_from_quat, quat_from_rotation, rotation_vector
from ..resources import Locations
from ..robots.robot import Robot
from ..scene.compose import hold_by_friction
from ..scene.robot import arm_spec, finger_places
from .subject import Subject, bare_spec, compiled, with_camera

_PREFIX = "hand_"
_BASE = "hand_base"
# The base weighs so much that nothing it holds is felt, and is driven as a robot's flange is: kg, N/m, N s/m.
_MASS, _STIFF, _DAMP = 20.0, 8e4, 2.6e3
_TURN_STIFF, _TURN_DAMP = 2e3, 60.0


def _arm(locations: Locations) -> ArmConfig:
    return load_config(RigConfig, "rigs", RIG, locations).arms[0]


def full_opening(locations: Locations) -> float:
    """How far one of the hand's fingers opens, m."""
    fingers = _arm(locations).robot.fingers
    assert fingers is not None  # the rig is ours, and has some
    return fingers.full_opening


@dataclass
class Hand:
    """A hand, and a thing without ground. The hand's base has the frame of its pinch.

    Attributes:
        T_start: where the base's joints are all at 0 (4, 4).
    """

    looked: Subject
    robot: Robot
    model: mujoco.MjModel
    data: mujoco.MjData
    T_start: Array

    @classmethod
    def of(cls, looked: Subject) -> Hand:
        """At the origin, fingers as the model has them."""
        arm = _arm(looked.locations)
        child, robot = arm_spec(arm, None), arm.robot
        for actuator in list(child.actuators):
            if actuator.name in robot.joint_drives:
                child.delete(actuator)
        child.delete(child.joint(robot.joint_names[-1]))
        link, pinch = child.body(robot.flange), child.site("pinch_site")
        link.pos, link.quat = (0, 0, 0), (1, 0, 0, 0)
        T = inverse(pose_from_quat(pinch.pos, pinch.quat))
        size = float(np.linalg.norm(np.ptp(looked.touching, axis=0)))
        spec = with_camera(bare_spec(looked.item, looked.meshes), (0, 0, 0.04), max(size, 0.22), steep=0.35)
        base = spec.worldbody.add_body(name=_BASE, mass=_MASS, inertia=[0.2, 0.2, 0.2], gravcomp=1)
        base.explicitinertial = True
        slide = (mujoco.mjtJoint.mjJNT_SLIDE, _STIFF, _DAMP)
        hinge = (mujoco.mjtJoint.mjJNT_HINGE, _TURN_STIFF, _TURN_DAMP)
        for first, (kind, stiff, damp) in ((0, slide), (3, hinge)):
            for axis in range(3):
                name = f"{_BASE}_{first + axis}"
                base.add_joint(name=name, type=kind, axis=np.eye(3)[axis])
                drive = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
                drive.set_to_position(kp=stiff, kv=damp)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # MuJoCo tells of options of the arm that do not count here.
            frame = base.add_frame(pos=T[:3, 3], quat=quat_from_rotation(T[:3, :3]))
            frame.attach_body(link, _PREFIX, "")
        for body in spec.bodies:
            if body.name.startswith(_PREFIX):
                body.gravcomp = 1
        hold_by_friction(spec)
        model = compiled(spec)
        return cls(looked, robot, model, mujoco.MjData(model), np.eye(4))

    def reach(self, T_pinch: Array, opening: float) -> None:
        """Put the hand where its pads are at (4, 4) and so far open each (m), and the thing at the origin; at rest."""
        body = self.model.body(_BASE)
        body.pos, body.quat = T_pinch[:3, 3], quat_from_rotation(T_pinch[:3, :3])
        self.T_start = T_pinch
        mujoco.mj_resetData(self.model, self.data)
        address, sign = finger_places(self.model, self.robot, _PREFIX)
        self.data.qpos[address] = opening * sign
        self.squeeze(opening)
        mujoco.mj_forward(self.model, self.data)

    def aim(self, T_pinch: Array) -> None:
        """Tell the base where to go."""
        T = inverse(self.T_start) @ T_pinch
        for number, value in enumerate((*T[:3, 3], *_angles(T[:3, :3]))):
            self.data.ctrl[self.model.actuator(f"{_BASE}_{number}").id] = value

    def squeeze(self, told: float) -> None:
        """Tell the gripper's drive how far each finger is to be open, m; less than it can be is a force."""
        drive = self.model.actuator(f"{_PREFIX}gripper").id
        self.data.ctrl[drive] = np.clip(told, *self.model.actuator_ctrlrange[drive])

    def run(self, seconds: float) -> None:
        """Let time pass."""
        for _ in range(round(seconds / self.model.opt.timestep)):
            mujoco.mj_step(self.model, self.data)

    @property
    def drive_gain(self) -> float:
        """Of the gripper's drive, N/m; both pads share its force."""
        return float(self.model.actuator_gainprm[self.model.actuator(f"{_PREFIX}gripper").id][0])

    @property
    def T_thing_in_pinch(self) -> Array:
        """How the thing lies between the pads (4, 4)."""
        site, body = self.data.site(f"{_PREFIX}pinch_site"), self.data.body(self.looked.item.name)
        T: Array = inverse(pose(site.xpos, site.xmat.reshape(3, 3))) @ pose(body.xpos, body.xmat.reshape(3, 3))
        return T


def slip(before: Array, after: Array) -> tuple[float, float]:
    """How far what was between the pads has moved (m), and how far the thing has turned (rad)."""
    T = after @ inverse(before)
    return float(np.linalg.norm(T[:3, 3])), float(np.linalg.norm(rotation_vector(T[:3, :3])))


def _angles(rotation: Array) -> Array:
    """Angles (3,) about x, then the new y, then the new z, rad; the second below a right angle."""
    y = np.arcsin(np.clip(rotation[0, 2], -1, 1))
    return np.array([np.arctan2(-rotation[1, 2], rotation[2, 2]), y, np.arctan2(-rotation[0, 1], rotation[0, 0])])
