"""Inverse kinematics of an arm, and the torques that its paths take."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.made_up_robot import RIG, write_robot
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.expert.planning.dynamics import ArmDynamics
from yamsim_cli.core.expert.planning.ik import IkSolver, Tolerance
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import invert_pose, pose, rotation_z
from yamsim_cli.core.scene.arm_model import arm_spec, kinematic_model

# Source: I2RT YAM as in MuJoCo Menagerie i2rt_yam, ranges in rad.
LOW = np.array([-2.61799, 0, 0, -1.5708, -1.5708, -2.0944])
HIGH = np.array([3.05433, 3.66519, 3.66519, 1.5708, 1.5708, 2.0944])


@pytest.fixture(scope="module")
def ik(config: RecordConfig) -> IkSolver:
    return IkSolver(kinematic_model(config.rig.arms[0]), np.eye(4))


def test_solution_is_where_forward_kinematics_says(ik: IkSolver) -> None:
    ik.set_held_object_frame(np.eye(4))
    rng = np.random.default_rng(0)
    for _ in range(20):
        joints = rng.uniform([-1, 1.2, 0.8, -1.2, -0.4, -0.8], [1, 1.9, 1.6, -0.6, 0.4, 0.8])
        T = ik.forward_kinematics(joints)
        solution = ik.solve(T, joints + rng.uniform(-0.1, 0.1, 6), 100)
        np.testing.assert_allclose(ik.forward_kinematics(solution.joints), T, atol=1e-4)
        assert solution.position_error < 1e-5


def test_a_held_frame_is_what_is_brought_to_the_target(ik: IkSolver) -> None:
    joints = np.array([0.2, 1.5, 1.2, -1.0, 0.1, 0.3])
    held = pose((0.01, -0.02, 0.03), rotation_z(0.4))
    ik.set_held_object_frame(np.eye(4))
    T_pinch = ik.forward_kinematics(joints)
    ik.set_held_object_frame(held)
    np.testing.assert_allclose(ik.forward_kinematics(joints), T_pinch @ held, atol=1e-12)


def test_targets_are_in_world(config: RecordConfig) -> None:
    T_base = pose((0.3, -0.4, 0.1), rotation_z(0.7))
    moved = IkSolver(kinematic_model(config.rig.arms[0]), T_base)
    at_origin = IkSolver(kinematic_model(config.rig.arms[0]), np.eye(4))
    joints = np.array([0.2, 1.5, 1.2, -1.0, 0.1, 0.3])
    np.testing.assert_allclose(
        invert_pose(T_base) @ moved.forward_kinematics(joints), at_origin.forward_kinematics(joints), atol=1e-12
    )
    assert moved.solve(moved.forward_kinematics(joints), joints + 0.05, 100).position_error < 1e-5


def test_out_of_reach_is_said_not_hidden(ik: IkSolver) -> None:
    ik.set_held_object_frame(np.eye(4))
    solution = ik.solve(pose((1.2, 0, 0.1)), np.array([0, 1.5, 1.2, -1.0, 0, 0]), 100)
    assert solution.position_error > 0.3
    assert (solution.joints >= LOW - 1e-6).all()
    assert (solution.joints <= HIGH + 1e-6).all()


def test_torques_move_the_arm_along_the_path(config: RecordConfig) -> None:
    """Forward dynamics with the torques alone follows the path of the inverse dynamics."""
    arm = config.rig.arms[0]
    dynamics = ArmDynamics(arm_spec(arm, None).compile(), arm.robot)
    model = arm_spec(arm, None).compile()
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION | mujoco.mjtDisableBit.mjDSBL_CONTACT
    model.opt.timestep = 0.001
    tick, n = 0.01, 60
    start = np.array([0.1, 1.5, 1.2, -0.8, 0.2, 0.3])
    ease = (1 - np.cos(np.linspace(0, np.pi, n + 1)))[:, None] / 2
    joints = start + ease * np.array([0.5, 0.3, 0.4, -0.3, 0.4, -0.5])
    data = mujoco.MjData(model)
    data.qpos[:6] = start
    for torque in dynamics.inverse_dynamics_torques(joints, np.zeros(n), tick):
        data.qfrc_applied[:6] = torque
        mujoco.mj_step(model, data, 10)
    np.testing.assert_allclose(data.qpos[:6], joints[-1], atol=0.05)


@pytest.mark.parametrize("rig", ["single", RIG])
def test_a_weight_in_the_hand_is_borne_by_every_joint_that_lifts_it(
    rig: str, tmp_path: Path, locations: Locations
) -> None:
    """Also for five joints: a joint's torque is the weight times how much the joint lifts it."""
    write_robot(tmp_path)
    where = Locations((tmp_path, *locations.data), locations.assets)
    arm = load_config(RigConfig, "rigs", rig, where).arms[0]
    model = arm_spec(arm, {}).compile()
    data = mujoco.MjData(model)
    addresses = [model.joint(name).qposadr[0] for name in arm.robot.joint_names]
    point, joints = np.array([0.01, 0.02, 0.03]), np.array(arm.robot.start)

    def height(at: np.ndarray) -> float:
        data.qpos[addresses] = at
        mujoco.mj_kinematics(model, data)
        site = data.site("pinch_site")
        return float((site.xpos + site.xmat.reshape(3, 3) @ point)[2])

    dynamics = ArmDynamics(arm_spec(arm, {}).compile(), arm.robot)
    (torques,) = dynamics.payload_torques(joints[None], point, weight=5.0)
    lifting = [(height(joints + step) - height(joints - step)) / 2e-6 for step in 1e-6 * np.eye(len(joints))]
    np.testing.assert_allclose(torques, 5.0 * np.array(lifting), atol=1e-6)


def test_a_waypoint_may_lean_where_the_pose_itself_is_out_of_reach(ik: IkSolver) -> None:
    wide, narrow = Tolerance(4e-3, math.radians(6.0), allow_tilt=True), Tolerance(1.5e-3, math.radians(2.0))
    rng, found = np.random.default_rng(0), 0
    for _ in range(200):
        joints = rng.uniform(LOW + 0.2, HIGH - 0.2)
        joints[4] = HIGH[4] - narrow.joint_limit_margin + 0.04
        T = ik.forward_kinematics(joints)
        if ik.solve_from(T, [joints], narrow) is None and (leaning := ik.solve_from(T, [joints], wide)) is not None:
            found += 1
            T_there = ik.forward_kinematics(leaning)
            turned = np.arccos(np.clip((np.trace(T[:3, :3].T @ T_there[:3, :3]) - 1) / 2, -1.0, 1.0))
            assert np.linalg.norm(T_there[:3, 3] - T[:3, 3]) < 1e-5 and turned <= wide.rotation
            assert np.minimum(leaning - LOW, HIGH - leaning).min() >= wide.joint_limit_margin
    assert found >= 5
