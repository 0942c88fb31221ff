"""Check that `pick` lifts an object, and that a turning, shaking hand does not drop it."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import ArmConfig, RigConfig
from yamsim_cli.core.expert.skills.planning_context import SkillFailedError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import (
    Array,
    invert_pose,
    pose,
    pose_from_quat,
    quat_from_rotation,
    rotation_from_vector,
    rotation_vector,
)
from yamsim_cli.core.robots.robot import Robot
from yamsim_cli.core.scene.arm_model import arm_spec, finger_addresses
from yamsim_cli.core.scene.compilation import physics_failure
from yamsim_cli.core.scene.compose import set_friction_cones
from yamsim_cli.objects.certify.single_object_pick import PICK_RIG, PickedGrasp, simulate_pick

from .check_outcome import CheckOutcome, CheckView, round_significant, skipped_outcome
from .tested_object import TestedObject, add_view_camera, compile_or_raise, object_spec, step_seconds

_CLOSE_TIME, _LIFT_TIME, _TURN_TIME, _SHAKE_TIME = 0.8, 0.8, 1.6, 1.0  # s
_COMMAND_PERIOD = 0.02  # s
_LIFT_HEIGHT, _TURN_ANGLE = 0.05, np.radians(45)  # m; rad, about x and y of the pinch frame
_SHAKE_AMPLITUDE, _SHAKE_RATE = 0.015, 3.0  # m, Hz, along each axis of `world`
_MAX_SLIP, _MAX_TURN = 0.012, np.radians(20)  # m, rad; a held object moves less relative to the pads

_PREFIX, _BASE = "hand_", "hand_base"
_BASE_MASS = 20.0  # kg, so that a held object does not move the base
_SLIDE_STIFFNESS, _SLIDE_DAMPING = 8e4, 2.6e3  # N/m, N s/m; as stiff as an arm's flange
_HINGE_STIFFNESS, _HINGE_DAMPING = 2e3, 60.0  # N m/rad, N m s/rad


def check_grasp(tested_object: TestedObject) -> CheckOutcome:
    """Run `pick`, and check that two finger pads hold the object by the resulting grasp."""
    item = tested_object.item
    if item.links or item.base == "fixed":
        return skipped_outcome("it is not lifted but opened, by its handles")
    if item.grasp is None or item.grasp.friction is None:
        return skipped_outcome("its config has no grasp by friction")
    friction = item.grasp.friction
    if friction.hands > 1:
        return skipped_outcome("its grasp needs two hands, and this check has one")
    widest = _full_opening(tested_object.locations)
    if all(point.opening >= widest for point in friction.points):
        return skipped_outcome(
            f"{2000 * item.grasp.opening:.4g} mm wide, but the gripper opens by at most {2000 * widest:.4g} mm"
        )
    try:
        taken = simulate_pick(item, replace(tested_object.locations, meshes=tested_object.meshes))
    except SkillFailedError as error:
        return CheckOutcome(
            False, {"force_n": round_significant(friction.force, 3)}, f"the skill `pick` fails: {error}"
        )
    return _check_hold(_GripperRig.for_object(tested_object), taken, item.grasp.clearance)


def _check_hold(hand: _GripperRig, taken: PickedGrasp, clearance: float) -> CheckOutcome:
    T = invert_pose(taken.T_thing_in_pinch)
    gravity = hand.model.opt.gravity.copy()
    # Gravity is off until the pads press.
    hand.model.opt.gravity[:] = 0.0
    hand.reset_at(T, min(taken.opening + clearance, _full_opening(hand.subject.locations)))
    for share in np.linspace(0, 1, round(_CLOSE_TIME / 2 / _COMMAND_PERIOD)):
        hand.command_opening(taken.opening + clearance * (1 - share))
        hand.run(_COMMAND_PERIOD)
    hand.command_opening(taken.opening - 2 * taken.force / hand.drive_gain)
    hand.run(_CLOSE_TIME / 2)
    hand.model.opt.gravity[:] = gravity
    held = hand.T_thing_in_pinch
    slips = [_move_along(hand, T, held, np.linspace(0, 1, round(_LIFT_TIME / _COMMAND_PERIOD)), _lifted_pose)]
    views = [CheckView(hand.model, hand.data.qpos.copy(), "lifted")]
    swing = np.sin(np.linspace(0, np.pi, round(_TURN_TIME / _COMMAND_PERIOD)))
    slips += [_move_along(hand, T, held, swing, functools.partial(_turned_pose, axis=axis)) for axis in (0, 1)]
    times = np.linspace(0, _SHAKE_TIME, round(_SHAKE_TIME / _COMMAND_PERIOD))
    slips += [_move_along(hand, T, held, times, functools.partial(_shaken_pose, axis=axis)) for axis in range(3)]
    views.append(CheckView(hand.model, hand.data.qpos.copy(), "after turning and shaking"))
    moved, turned = (max(each[k] for each in slips) for k in (0, 1))
    fault = ""
    if physics_failure(hand.data) is not None or not np.isfinite(hand.data.qpos).all():
        fault = "physics broke down"
    elif moved > _MAX_SLIP or turned > _MAX_TURN:
        motions = ("lifted", "turned", "turned", "shaken", "shaken", "shaken")
        when = next(word for word, (a, b) in zip(motions, slips, strict=True) if a > _MAX_SLIP or b > _MAX_TURN)
        fault = f"when {when}, it slips {moved * 1000:.3g} mm and turns {np.degrees(turned):.3g} degrees in the pads"
    figures = {
        "force_n": round_significant(taken.force, 3),
        "lean_deg": round_significant(np.degrees(np.arccos(np.clip(-T[2, 2], -1, 1))), 3),
        "slip_mm": round_significant(moved * 1000, 3),
        "turn_deg": round_significant(np.degrees(turned), 3),
    }
    return CheckOutcome(not fault, figures, fault, tuple(views))


def _move_along(
    hand: _GripperRig, T: Array, held: Array, path: Array, at: Callable[[Array, float], Array]
) -> tuple[float, float]:
    """Move the hand along `at(T, share)`; return the object's largest slip (m) and rotation (rad) from `held`."""
    most = (0.0, 0.0)
    for share in path:
        hand.command_pinch_pose(at(T, float(share)))
        hand.run(_COMMAND_PERIOD)
        moved, turned = _object_displacement(held, hand.T_thing_in_pinch)
        most = (max(most[0], moved), max(most[1], turned))
    return most


def _lifted_pose(T: Array, share: float) -> Array:
    return pose((0, 0, _LIFT_HEIGHT * share)) @ T


def _turned_pose(T: Array, share: float, axis: int) -> Array:
    return pose((0, 0, _LIFT_HEIGHT)) @ T @ pose((0, 0, 0), rotation_from_vector(_TURN_ANGLE * share * np.eye(3)[axis]))


def _shaken_pose(T: Array, time: float, axis: int) -> Array:
    by = _SHAKE_AMPLITUDE * np.sin(2 * np.pi * _SHAKE_RATE * time) * np.eye(3)[axis]
    return pose(np.array([0, 0, _LIFT_HEIGHT]) + by) @ T


def _load_pick_arm(locations: Locations) -> ArmConfig:
    return load_config(RigConfig, "rigs", PICK_RIG, locations).arms[0]


def _full_opening(locations: Locations) -> float:
    fingers = _load_pick_arm(locations).robot.fingers
    assert fingers is not None
    return fingers.full_opening


@dataclass
class _GripperRig:
    """A free object, and a gripper `linear_4310` on a base that six drives move.

    The base's frame is the pinch frame; `T_start` is its pose (4, 4) in `world` with joints at 0.
    """

    subject: TestedObject
    robot: Robot
    model: mujoco.MjModel
    data: mujoco.MjData
    T_start: Array

    @classmethod
    def for_object(cls, tested_object: TestedObject) -> _GripperRig:
        arm = _load_pick_arm(tested_object.locations)
        child, robot = arm_spec(arm, None), arm.robot
        for actuator in list(child.actuators):
            if actuator.name in robot.joint_drives:
                child.delete(actuator)
        child.delete(child.joint(robot.joint_names[-1]))
        link, pinch = child.body(robot.flange), child.site("pinch_site")
        link.pos, link.quat = (0, 0, 0), (1, 0, 0, 0)
        T = invert_pose(pose_from_quat(pinch.pos, pinch.quat))
        spec = add_view_camera(
            object_spec(tested_object.item, tested_object.meshes),
            (0, 0, 0.04),
            max(tested_object.bounding_diagonal, 0.22),
            steep=0.35,
        )
        base = spec.worldbody.add_body(name=_BASE, mass=_BASE_MASS, inertia=[0.2, 0.2, 0.2], gravcomp=1)
        base.explicitinertial = True
        slide = (mujoco.mjtJoint.mjJNT_SLIDE, _SLIDE_STIFFNESS, _SLIDE_DAMPING)
        hinge = (mujoco.mjtJoint.mjJNT_HINGE, _HINGE_STIFFNESS, _HINGE_DAMPING)
        for first, (kind, stiff, damp) in ((0, slide), (3, hinge)):
            for axis in range(3):
                name = f"{_BASE}_{first + axis}"
                base.add_joint(name=name, type=kind, axis=np.eye(3)[axis])
                drive = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
                drive.set_to_position(kp=stiff, kv=damp)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # arm options without effect here cause warnings
            frame = base.add_frame(pos=T[:3, 3], quat=quat_from_rotation(T[:3, :3]))
            frame.attach_body(link, _PREFIX, "")
        for body in spec.bodies:
            if body.name.startswith(_PREFIX):
                body.gravcomp = 1
        set_friction_cones(spec)
        model = compile_or_raise(spec)
        return cls(tested_object, robot, model, mujoco.MjData(model), np.eye(4))

    def reset_at(self, T_pinch: Array, opening: float) -> None:
        body = self.model.body(_BASE)
        body.pos, body.quat = T_pinch[:3, 3], quat_from_rotation(T_pinch[:3, :3])
        self.T_start = T_pinch
        mujoco.mj_resetData(self.model, self.data)
        address, sign = finger_addresses(self.model, self.robot, _PREFIX)
        self.data.qpos[address] = opening * sign
        self.command_opening(opening)
        mujoco.mj_forward(self.model, self.data)

    def command_pinch_pose(self, T_pinch: Array) -> None:
        T = invert_pose(self.T_start) @ T_pinch
        for number, value in enumerate((*T[:3, 3], *_euler_angles(T[:3, :3]))):
            self.data.ctrl[self.model.actuator(f"{_BASE}_{number}").id] = value

    def command_opening(self, opening: float) -> None:
        """Command each finger's opening, m; below half the object's width, it exerts a force."""
        drive = self.model.actuator(f"{_PREFIX}gripper").id
        self.data.ctrl[drive] = np.clip(opening, *self.model.actuator_ctrlrange[drive])

    def run(self, seconds: float) -> None:
        step_seconds(self.model, self.data, seconds)

    @property
    def drive_gain(self) -> float:
        """The gripper drive's position gain, N/m; each pad gets half of its force."""
        return float(self.model.actuator_gainprm[self.model.actuator(f"{_PREFIX}gripper").id][0])

    @property
    def T_thing_in_pinch(self) -> Array:
        site, body = self.data.site(f"{_PREFIX}pinch_site"), self.data.body(self.subject.item.name)
        T: Array = invert_pose(pose(site.xpos, site.xmat.reshape(3, 3))) @ pose(body.xpos, body.xmat.reshape(3, 3))
        return T


def _object_displacement(before: Array, after: Array) -> tuple[float, float]:
    """Return translation at the pads (m) and rotation (rad) between two object poses."""
    T = after @ invert_pose(before)
    return float(np.linalg.norm(T[:3, 3])), float(np.linalg.norm(rotation_vector(T[:3, :3])))


def _euler_angles(rotation: Array) -> Array:
    """Return intrinsic x-y-z Euler angles (3,), rad."""
    y = np.arcsin(np.clip(rotation[0, 2], -1, 1))
    return np.array([np.arctan2(-rotation[1, 2], rotation[2, 2]), y, np.arctan2(-rotation[0, 1], rotation[0, 0])])
