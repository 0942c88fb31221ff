"""Hand poses as actions of the station in Inspect Robots, with depth: what agents use that read text and images."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("inspect_robots", reason="needs yamsim[inspect]")
pytest.importorskip("kitchenbench", reason="needs yamsim[inspect]")

from inspect_robots import Action, ActionChunk, EmbodimentInfo, Observation, PolicyConfig, PolicyInfo, Scene
from inspect_robots import eval as evaluate
from inspect_robots.conformance import assert_embodiment_conformant
from inspect_robots.policy import PolicyBase

from yamsim_cli.core.errors import UsageError
from yamsim_cli.core.expert.planning.arm_kinematics import ArmKinematics
from yamsim_cli.core.geometry.se3 import Array, invert_pose
from yamsim_cli.core.scene.arm_model import kinematic_model
from yamsim_cli.kitchenbench.benchmark_scene import open_station_session
from yamsim_cli.kitchenbench.cartesian_control import EEF_LABELS, EEF_STATE, START, CartesianArm
from yamsim_cli.kitchenbench.embodiment import JOINTS, YamsimEmbodiment
from yamsim_cli.kitchenbench.own_tasks import make_task


@pytest.fixture(scope="module")
def arm_and_kinematics() -> tuple[CartesianArm, ArmKinematics]:
    config = open_station_session("64x48", images=False).config.rig.arms[0]
    arm = CartesianArm(config)
    arm.start_at(START[:6])
    return arm, ArmKinematics(kinematic_model(config))


def test_the_declaration_is_that_of_the_real_station() -> None:
    info = YamsimEmbodiment(images=False, control_interface="eef_pos").info
    assert_embodiment_conformant(info)
    space = info.action_space
    assert space.semantics.control_mode == "eef_abs_pose" and space.semantics.frame == "base"
    assert space.semantics.dim_labels == EEF_LABELS and EEF_LABELS[:2] == ("left_x", "left_y")
    assert info.observation_space.state.keys == {EEF_STATE, "realization_seed"}
    fixed = {label for label, low, high in zip(EEF_LABELS, space.low, space.high, strict=True) if low == high}
    assert fixed == {"left_pitch", "left_roll", "right_pitch", "right_roll"}
    tilting = YamsimEmbodiment(images=False, control_interface="eef_pos", eef_orientation=True).info.action_space
    assert (tilting.low < tilting.high).all()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"control_interface": "eef"}, "control_interface='eef': did you mean 'eef_pos'"),
        ({"eef_orientation": True}, "eef_orientation needs control_interface=eef_pos"),
        ({"depth": True}, "depth needs images=true"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(arguments: dict[str, Any], told: str) -> None:
    with pytest.raises(UsageError, match=told):
        YamsimEmbodiment(images=False, **arguments)


def test_poses_and_joints_belong_together(arm_and_kinematics: tuple[CartesianArm, ArmKinematics]) -> None:
    arm, kinematics = arm_and_kinematics
    start = np.array(START[:6])
    assert arm.pose_at(start) == pytest.approx([*kinematics.T_grasp_in_base(start)[:3, 3], 0, 0, 0])
    for change in np.random.default_rng(0).uniform(-0.4, 0.4, (50, 6)):
        T = kinematics.T_grasp_in_base(arm.joints_at(arm.pose_at(start + change), start))
        np.testing.assert_allclose(T, kinematics.T_grasp_in_base(start + change), atol=1e-6)


@pytest.mark.parametrize(("angle", "moves"), [("pitch", [1, 0]), ("roll", [0, 1])])
def test_positive_angles_tip_the_hand_ahead_and_to_the_left(
    angle: str, moves: list[int], arm_and_kinematics: tuple[CartesianArm, ArmKinematics]
) -> None:
    arm, kinematics = arm_and_kinematics
    start = np.array(START[:6])
    target = arm.pose_at(start)
    target[EEF_LABELS.index(f"left_{angle}")] = 0.3
    before, after = (kinematics.T_grasp_in_base(q)[:3, 2] for q in (start, arm.joints_at(target, start)))
    # Axis z of the grasp site points out of the hand, which points ahead and down.
    change = (after - before)[:2]
    assert before[2] < -0.4
    assert abs(change @ moves) > 0.9 * np.linalg.norm(change) and change @ moves > 0.1


def test_a_pose_out_of_reach_gives_the_nearest_joints(
    arm_and_kinematics: tuple[CartesianArm, ArmKinematics],
) -> None:
    arm, kinematics = arm_and_kinematics
    start = np.array(START[:6])
    joints = arm.joints_at(np.array([1.5, 0.0, 0.2, 0.0, 0.0, 0.0]), start)
    assert np.isfinite(joints).all()
    assert kinematics.T_grasp_in_base(joints)[0, 3] > 0.6


@pytest.mark.render
def test_depth_and_intrinsics_give_points_on_the_table() -> None:
    embodiment = YamsimEmbodiment(size="64x48", depth=True, control_interface="eef_pos")
    try:
        observation = embodiment.reset(make_task("pickplace").scenes[0], seed=1)
        assert {"top_depth", "left_intrinsics", "right_depth"} < observation.extra.keys()
        assert JOINTS in observation.state
        points = points_in_world(observation, embodiment)
        on_table = points[(np.abs(points[..., 0] - 0.4) < 0.1) & (np.abs(points[..., 1]) < 0.05)]
        assert len(on_table) > 20 and abs(np.median(on_table[:, 2])) < 2e-3
    finally:
        embodiment.close()


def points_in_world(observation: Observation, embodiment: YamsimEmbodiment) -> Array:
    """Return the points (height, width, 3) that the camera `top` sees, by the observed depth and intrinsics."""
    depth, K = observation.extra["top_depth"], observation.extra["top_intrinsics"]
    rows, columns = np.indices(depth.shape)
    rays = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ np.linalg.inv(K).T
    # The owner of a station has its camera's pose by calibration.
    simulator = embodiment.simulator
    assert simulator is not None
    T = simulator.scene.T_base_in_world @ simulator.state_replay.T_cam_in_base("top")
    points: Array = rays * depth[..., None] @ T[:3, :3].T + T[:3, 3]
    return points


class SeeingAgent(PolicyBase):
    """Moves the hands out of view, finds the banana and the plate by an image and its depth, and acts by hand poses."""

    def __init__(self, embodiment: YamsimEmbodiment) -> None:
        self._embodiment, info = embodiment, embodiment.info
        self.info = PolicyInfo(
            name="seeing_agent",
            action_space=info.action_space,
            observation_space=info.observation_space,
            control_hz=info.control_hz,
        )
        self.config = PolicyConfig()
        self.seen: list[
            tuple[Array, Array]
        ] = []  # in each trial: where the banana and the plate are, in the arm's base

    def bind(self, embodiment_info: EmbodimentInfo) -> None:
        """Need nothing more of the embodiment."""

    def reset(self, scene: Scene) -> None:
        self._calls = 0

    def act(self, observation: Observation) -> ActionChunk:
        self._calls += 1
        state = observation.state[EEF_STATE].copy()
        if self._calls == 1:
            for arm, y in ((0, 0.2), (1, -0.2)):
                state[7 * arm : 7 * arm + 7] = [0.16, y, 0.35, 0, 0, 0, 1]
            return ActionChunk([Action(state)] * 5, control_hz=self.info.control_hz)
        if self._calls > 2:
            return ActionChunk([Action(state)], control_hz=self.info.control_hz)
        points, image = points_in_world(observation, self._embodiment), observation.images["top"].astype(int)
        low = (points[..., 2] > 0.006) & (points[..., 2] < 0.05) & (points[..., 0] > 0.2)
        yellow = (image[..., 0] - image[..., 2] > 60) & (image[..., 1] - image[..., 2] > 40)
        banana, plate = points[low & yellow], points[low & ~yellow]
        simulator = self._embodiment.simulator
        assert simulator is not None
        bases = [arm.T_base_in_world for arm in simulator.scene.arms]
        arm = int(np.argmin([np.linalg.norm(T[:2, 3] - banana.mean(axis=0)[:2]) for T in bases]))
        T = invert_pose(bases[arm])
        banana, plate = (part @ T[:3, :3].T + T[:3, 3] for part in (banana, plate))
        axis = np.linalg.svd(banana[:, :2] - banana[:, :2].mean(axis=0))[2][0]
        # With yaw 0, the fingers close along y. They have to close across the banana.
        yaw = (np.arctan2(axis[1], axis[0]) + np.pi / 2) % np.pi - np.pi / 2
        pick, place = np.median(banana, axis=0)[:2], np.median(plate, axis=0)[:2]
        self.seen.append((pick, place))
        actions = []
        for (x, y), z, gripper, repeats in (
            (pick, 0.15, 1, 5),
            (pick, 0.03, 1, 5),
            (pick, 0.03, 0, 3),
            (pick, 0.20, 0, 4),
            (place, 0.20, 0, 5),
            (place, 0.07, 0, 4),
            (place, 0.07, 1, 3),
            (place, 0.25, 1, 6),
        ):
            state[7 * arm : 7 * arm + 7] = [x, y, z, yaw, -0.6, 0, gripper]
            actions += [Action(state.copy())] * repeats
        return ActionChunk(actions, control_hz=self.info.control_hz)


@pytest.mark.slow
@pytest.mark.render
def test_an_agent_that_sees_picks_and_places_by_hand_poses(tmp_path: Path) -> None:
    embodiment = YamsimEmbodiment(size="320x240", depth=True, control_interface="eef_pos", eef_orientation=True)
    try:
        task = replace(make_task("pickplace"), epochs=6)
        agent = SeeingAgent(embodiment)
        (log,) = evaluate(task, policy=agent, embodiment=embodiment, log_dir=str(tmp_path))
    finally:
        embodiment.close()
    assert log.status == "success"
    # A banana or plate farther ahead is outside the bounds of the poses.
    successes = [epoch["success_at_end"] for epoch in log.samples[0].epochs]
    within = [max(pick[0], place[0]) < 0.46 for pick, place in agent.seen]
    assert sum(within) >= 1
    assert all(success for success, inside in zip(successes, within, strict=True) if inside), (successes, agent.seen)
