from __future__ import annotations

import mujoco
import numpy as np
import pytest
from yamsim_cli.core.planning.choice import PathChooser
from yamsim_cli.core.sim.monitor import object_pose
from yamsim_cli.core.sim.rollout import Rollout, attach, drive_command, path_actions, path_start, simulate
from yamsim_cli.core.tasks.pickplace import sample_layout
from yamsim_cli.core.tasks.plans import phases

from tests.core.attempts import all_actions
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.geometry.se3 import inverse
from yamsim_cli.core.planning.arm_tools import start_stands
from yamsim_cli.core.planning.dynamics import ArmDynamics
from yamsim_cli.core.planning.ik import IkSolver
from yamsim_cli.core.resources import Locations
from yamsim_cli.core.scene.build import build_scene
from yamsim_cli.core.scene.compiled import CompiledScene
from yamsim_cli.core.scene.robot import arm_spec, bare_arm
from yamsim_cli.core.session import Session
from yamsim_cli.core.sim.replica import Replica
from yamsim_cli.core.types import Actions, JointPath, Layout


@pytest.fixture(scope="module")
def scene(config: RecordConfig, locations: Locations) -> CompiledScene:
    return build_scene(Session(config, locations))


@pytest.fixture(scope="module")
def layout(config: RecordConfig) -> Layout:
    layout = sample_layout(config, np.random.default_rng(4))
    assert layout is not None
    return layout


@pytest.fixture(scope="module")
def path(config: RecordConfig, locations: Locations, scene: CompiledScene, layout: Layout) -> JointPath:
    ik = IkSolver(bare_arm(config.rig.arms[0]), np.eye(4))
    dynamics = ArmDynamics(arm_spec(config.rig.arms[0], None).compile(), config.rig.arms[0].robot)
    return PathChooser(ik, dynamics, scene, config.task, config.grasp, 0, start_stands(config)).choose(layout)[1]


def _run(scene: CompiledScene, config: RecordConfig, layout: Layout, path: JointPath) -> Rollout:
    start, held = path_start(scene, layout, [path]), [phases(config.task, config.grasp)]
    return simulate(scene, start, path_actions(scene, [path]), "banana", config.task.timing, held)


@pytest.fixture(scope="module")
def rollout(scene: CompiledScene, config: RecordConfig, layout: Layout, path: JointPath) -> Rollout:
    return _run(scene, config, layout, path)


def test_57_frames_two_ticks_apart(rollout: Rollout) -> None:
    assert len(rollout.states) == 57
    np.testing.assert_allclose([state.time for state in rollout.states], np.arange(57) * 0.064, atol=1e-9)


def test_the_same_attempt_gives_the_same_bits_again(
    scene: CompiledScene, config: RecordConfig, layout: Layout, path: JointPath, rollout: Rollout
) -> None:
    other = sample_layout(config, np.random.default_rng(9))
    assert other is not None
    _run(scene, config, other, path)
    again = _run(scene, config, layout, path)
    for before, after in zip(rollout.states, again.states, strict=True):
        assert (before.qpos == after.qpos).all()
        assert (before.actions.ctrl == after.actions.ctrl).all()
    assert (rollout.T_in_world["banana"] == again.T_in_world["banana"]).all()


def test_banana_ends_on_the_plate(rollout: Rollout) -> None:
    offset = rollout.T_in_world["banana"][:3, 3] - rollout.T_in_world["plate"][:3, 3]
    assert np.hypot(*offset[:2]) < 0.015
    assert 0.01 < offset[2] < 0.04
    assert rollout.object_speed < 0.05


def test_banana_lies_still_until_the_hand_comes(rollout: Rollout, layout: Layout) -> None:
    moved = rollout.T_object_before_grasp[:3, 3] - layout.T_in_world["banana"][:3, 3]
    assert np.linalg.norm(moved) < 0.002


def test_banana_moves_with_the_hand_while_the_magnet_holds(scene: CompiledScene, rollout: Rollout) -> None:
    replica = Replica(scene)
    held = []
    for state in rollout.states:
        if state.actions.magnet[0]:
            replica.show(state.qpos)
            held.append(inverse(replica.T_grasp_in_base()[0]) @ replica.T_object_in_base("banana"))
    assert len(held) == 24
    # The weld is soft: a few millimetres at the turns.
    positions = np.array(held)[1:, :3, 3]
    assert np.linalg.norm(positions - positions.mean(axis=0), axis=1).max() < 0.01


def test_attaching_moves_nothing(scene: CompiledScene, config: RecordConfig, layout: Layout) -> None:
    data = mujoco.MjData(scene.model)
    scene.start(data, layout, start_stands(config))
    mujoco.mj_step(scene.model, data, 200)
    mujoco.mj_kinematics(scene.model, data)
    before = object_pose(data, "banana")
    attach(scene.model, scene.arm, data, "banana")
    data.eq_active[scene.arm.weld] = True
    mujoco.mj_step(scene.model, data, 50)
    mujoco.mj_kinematics(scene.model, data)
    np.testing.assert_allclose(object_pose(data, "banana"), before, atol=2e-3)


def test_arm_follows_its_reference(scene: CompiledScene, rollout: Rollout, path: JointPath) -> None:
    reached = np.array([state.qpos[scene.arm.joint_qpos] for state in rollout.states])
    assert np.abs(reached - path.joints[:-1:2]).max() < 0.25


def test_action_is_the_plan_and_ctrl_what_the_drives_got(
    scene: CompiledScene, rollout: Rollout, path: JointPath
) -> None:
    for k, state in enumerate(rollout.states):
        acting = state.actions
        assert acting.ctrl.shape == (2, 7)
        assert (acting.joints.shape, acting.magnet.shape) == ((2, 1, 7), (2, 1))
        np.testing.assert_allclose(acting.joints[:, 0, :6], path.joints[2 * k + 1 : 2 * k + 3])
        assert acting.joints[0, 0, 6] == acting.ctrl[0, 6] == path.gripper[2 * k]
        assert tuple(acting.magnet[:, 0]) == path.magnet[2 * k : 2 * k + 2]
        np.testing.assert_array_equal(acting.ctrl[1, :6], drive_command(scene.arm, path, 2 * k + 1))
        assert (acting.ctrl[:, :6] >= scene.arm.ctrl_range[:, 0]).all()
        assert (acting.ctrl[:, :6] <= scene.arm.ctrl_range[:, 1]).all()


def test_recorded_actions_give_the_same_bits_from_the_first_frame(
    scene: CompiledScene, config: RecordConfig, rollout: Rollout
) -> None:
    held = [phases(config.task, "weld")]
    again = simulate(scene, rollout.states[0].qpos, all_actions(rollout.states), "banana", config.task.timing, held)
    for before, after in zip(rollout.states, again.states, strict=True):
        assert (before.qpos == after.qpos).all()
    assert (rollout.T_in_world["banana"] == again.T_in_world["banana"]).all()


def test_one_action_a_frame_would_not_be_enough(scene: CompiledScene, config: RecordConfig, rollout: Rollout) -> None:
    """Why every tick's command is kept: the first one of each frame, held for both ticks, lets the arm drift off."""
    actions = all_actions(rollout.states)
    held = Actions(actions.ctrl[::2].repeat(2, axis=0), actions.magnet, actions.joints)
    again = simulate(scene, rollout.states[0].qpos, held, "banana", config.task.timing, [phases(config.task, "weld")])
    apart = [
        np.abs((before.qpos - after.qpos)[scene.arm.joint_qpos]).max()
        for before, after in zip(rollout.states, again.states, strict=True)
    ]
    assert max(apart) > 0.02


def test_a_drive_at_rest_is_told_its_reference(scene: CompiledScene, path: JointPath) -> None:
    np.testing.assert_allclose(drive_command(scene.arm, path, 113), path.joints[-1], atol=0.02)
