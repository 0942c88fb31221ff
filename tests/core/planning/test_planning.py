from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from yamsim_cli.core.planning.choice import PathChooser
from yamsim_cli.core.tasks.pickplace import sample_layout

from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.geometry.se3 import inverse, pose, rotation_vector, rotation_z
from yamsim_cli.core.planning.arm_tools import start_stands
from yamsim_cli.core.planning.dynamics import ArmDynamics
from yamsim_cli.core.planning.ik import IkSolver
from yamsim_cli.core.resources import Locations
from yamsim_cli.core.scene.build import build_scene
from yamsim_cli.core.scene.robot import arm_spec, bare_arm
from yamsim_cli.core.session import Session
from yamsim_cli.core.tasks.randomness import Stream, generator
from yamsim_cli.core.types import EpisodeJob, JointPath, Layout, Plan

# Source: I2RT YAM as in MuJoCo Menagerie i2rt_yam (ranges) and DAMIAO's tables for its motors at 24 V (speeds, rad/s).
LOW = np.array([-2.61799, 0, 0, -1.5708, -1.5708, -2.0944])
HIGH = np.array([3.05433, 3.66519, 3.66519, 1.5708, 1.5708, 2.0944])
MOTOR_SPEED = np.array([52.5] * 3 + [200] * 3) * 2 * np.pi / 60
TORQUE = np.array([28, 28, 28, 10, 10, 10])


@pytest.fixture(scope="module")
def ik(config: RecordConfig, locations: Locations) -> IkSolver:
    return IkSolver(bare_arm(config.rig.arms[0]), np.eye(4))


@pytest.fixture(scope="module")
def dynamics(config: RecordConfig, locations: Locations) -> ArmDynamics:
    return ArmDynamics(arm_spec(config.rig.arms[0], None).compile(), config.rig.arms[0].robot)


@pytest.fixture(scope="module")
def chooser(config: RecordConfig, locations: Locations, ik: IkSolver, dynamics: ArmDynamics) -> PathChooser:
    scene = build_scene(Session(config, locations))
    return PathChooser(ik, dynamics, scene, config.task, config.grasp, 0, start_stands(config))


def _layout(config: RecordConfig, seed: int, attempt: int) -> Layout:
    layout = sample_layout(config, generator(EpisodeJob(seed, attempt), Stream.LAYOUT))
    assert layout is not None
    return layout


@pytest.fixture(scope="module")
def paths(config: RecordConfig, chooser: PathChooser) -> list[tuple[Plan, JointPath]]:
    return [chooser.choose(_layout(config, 3, attempt)) for attempt in range(30)]


def test_solution_is_where_forward_kinematics_says(ik: IkSolver) -> None:
    ik.hold(np.eye(4))
    rng = np.random.default_rng(0)
    for _ in range(20):
        joints = rng.uniform([-1, 1.2, 0.8, -1.2, -0.4, -0.8], [1, 1.9, 1.6, -0.6, 0.4, 0.8])
        T = ik.pose_of(joints)
        solution = ik.solve(T, joints + rng.uniform(-0.1, 0.1, 6), 100)
        np.testing.assert_allclose(ik.pose_of(solution.joints), T, atol=1e-4)
        assert solution.position_error < 1e-5


def test_a_held_frame_is_what_is_brought_to_the_target(ik: IkSolver) -> None:
    joints = np.array([0.2, 1.5, 1.2, -1.0, 0.1, 0.3])
    held = pose((0.01, -0.02, 0.03), rotation_z(0.4))
    ik.hold(np.eye(4))
    T_pinch = ik.pose_of(joints)
    ik.hold(held)
    np.testing.assert_allclose(ik.pose_of(joints), T_pinch @ held, atol=1e-12)


def test_targets_are_in_world(config: RecordConfig, locations: Locations) -> None:
    T_base = pose((0.3, -0.4, 0.1), rotation_z(0.7))
    moved = IkSolver(bare_arm(config.rig.arms[0]), T_base)
    at_origin = IkSolver(bare_arm(config.rig.arms[0]), np.eye(4))
    joints = np.array([0.2, 1.5, 1.2, -1.0, 0.1, 0.3])
    np.testing.assert_allclose(inverse(T_base) @ moved.pose_of(joints), at_origin.pose_of(joints), atol=1e-12)
    assert moved.solve(moved.pose_of(joints), joints + 0.05, 100).position_error < 1e-5


def test_out_of_reach_is_said_not_hidden(ik: IkSolver) -> None:
    ik.hold(np.eye(4))
    solution = ik.solve(pose((1.2, 0, 0.1)), np.array([0, 1.5, 1.2, -1.0, 0, 0]), 100)
    assert solution.position_error > 0.3
    assert (solution.joints >= LOW - 1e-6).all()
    assert (solution.joints <= HIGH + 1e-6).all()


@pytest.mark.slow
def test_the_whole_box_is_in_reach(config: RecordConfig, chooser: PathChooser) -> None:
    worst_tilt = 0.0
    for attempt in range(300):
        layout = _layout(config, 11, attempt)
        _, path = chooser.choose(layout)
        assert path.position_error < 0.001, layout
        worst_tilt = max(worst_tilt, path.tilt)
    assert np.degrees(worst_tilt) < 30.1


def test_path_has_the_tasks_number_of_ticks(paths: list[tuple[Plan, JointPath]]) -> None:
    for _, path in paths:
        assert path.joints.shape == (115, 6)
        assert path.torques.shape == path.velocities.shape == (114, 6)
        assert len(path.gripper) == len(path.magnet) == 114


def test_path_reaches_its_waypoints(paths: list[tuple[Plan, JointPath]], ik: IkSolver) -> None:
    for plan, path in paths:
        ik.hold(plan.T_object_in_pinch)
        assert path.position_error < 1e-3
        for k, waypoint in enumerate(plan.waypoints):
            reached = ik.pose_of(path.joints[(k + 1) * 12])
            np.testing.assert_allclose(reached[:3, 3], waypoint.T_object_in_world[:3, 3], atol=1e-3)


def test_path_stays_within_the_joints_and_motors_limits(paths: list[tuple[Plan, JointPath]]) -> None:
    for _, path in paths:
        assert (path.joints >= LOW - 1e-6).all()
        assert (path.joints <= HIGH + 1e-6).all()
        assert (np.abs(path.velocities) < 0.95 * MOTOR_SPEED).all()


def test_path_does_not_jump(paths: list[tuple[Plan, JointPath]]) -> None:
    """From one tick to the next no joint's speed changes by more than what it can do in a few ticks."""
    for _, path in paths:
        changes = np.diff(path.velocities, axis=0)
        assert np.abs(changes).max() < 3.0
        assert np.median(np.abs(changes)) < 0.2


def test_the_arm_moves_all_the_time(paths: list[tuple[Plan, JointPath]]) -> None:
    """No two frames, two ticks apart, have the same joints: no picture of a recording stands still."""
    for _, path in paths:
        assert np.abs(np.diff(path.joints[::2], axis=0)).max(axis=1).min() > 1e-5


def test_the_arm_ends_where_it_started(paths: list[tuple[Plan, JointPath]]) -> None:
    for _, path in paths:
        np.testing.assert_allclose(path.joints[-1], path.joints[0])


def test_the_arm_is_upright_while_it_holds(paths: list[tuple[Plan, JointPath]], ik: IkSolver) -> None:
    for plan, path in paths:
        ik.hold(plan.T_object_in_pinch)
        for joints, held in zip(path.joints[1:], path.magnet, strict=True):
            if held:
                tilt = rotation_vector(ik.pose_of(joints)[:3, :3])[:2]
                assert np.degrees(np.linalg.norm(tilt)) < 5


def test_magnet_holds_from_the_grasp_to_the_release(paths: list[tuple[Plan, JointPath]]) -> None:
    for _, path in paths:
        assert path.magnet == (False,) * 24 + (True,) * 48 + (False,) * 42


def test_fingers_close_before_the_lift_and_open_before_the_retreat(paths: list[tuple[Plan, JointPath]]) -> None:
    for _, path in paths:
        opened, closed = path.gripper[0], path.gripper[30]
        assert closed < opened
        assert path.gripper[12] == opened
        assert path.gripper[23] == pytest.approx(closed)
        assert path.gripper[60] == pytest.approx(closed)
        assert path.gripper[71] == pytest.approx(opened)


def test_torques_stay_within_the_drives(paths: list[tuple[Plan, JointPath]]) -> None:
    for _, path in paths:
        assert (np.abs(path.torques) < 0.7 * TORQUE).all()


def test_torques_move_the_arm_along_the_path(config: RecordConfig, locations: Locations, dynamics: ArmDynamics) -> None:
    """Forward dynamics under the torques alone follows the path that they were computed from."""
    spec = arm_spec(config.rig.arms[0], None)
    model = spec.compile()
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION | mujoco.mjtDisableBit.mjDSBL_CONTACT
    model.opt.timestep = 0.001
    tick, n = 0.01, 60
    start = np.array([0.1, 1.5, 1.2, -0.8, 0.2, 0.3])
    ease = (1 - np.cos(np.linspace(0, np.pi, n + 1)))[:, None] / 2
    joints = start + ease * np.array([0.5, 0.3, 0.4, -0.3, 0.4, -0.5])
    torques = dynamics.torques(joints, np.zeros(n), tick)
    data = mujoco.MjData(model)
    data.qpos[:6] = start
    for torque in torques:
        data.qfrc_applied[:6] = torque
        mujoco.mj_step(model, data, 10)
    np.testing.assert_allclose(data.qpos[:6], joints[-1], atol=0.05)


@pytest.mark.parametrize(("rig", "widest"), [("single", 0.0375), ("single_linear", 0.0475)])
def test_fingers_open_no_wider_than_they_go(
    rig: str, widest: float, make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    """An apple is as wide as the crank opens: there is no room for more around it."""
    config = make_config({("rig",): rig, ("task", "object"): "013_apple", ("task", "target"): "024_bowl"})
    arm, scene = config.rig.arms[0], build_scene(Session(config, locations))
    ik = IkSolver(bare_arm(arm), scene.T_base_in_world)
    dynamics = ArmDynamics(arm_spec(arm, None).compile(), arm.robot)
    chooser = PathChooser(ik, dynamics, scene, config.task, "weld", 0, start_stands(config))
    layout = sample_layout(config, generator(EpisodeJob(2, 0), Stream.LAYOUT))
    assert layout is not None
    _, path = chooser.choose(layout)
    assert path.gripper.max() <= widest + 1e-4
    assert path.gripper.max() >= 0.0372
