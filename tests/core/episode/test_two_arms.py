"""Rigs of two arms: either arm picks and places while the other rests, or one hands over to the other."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.attempts import all_actions, planned
from tests.cli.run_cli import yamsim
from tests.unrendered import SIZE, change_frame, read_frame, write_dataset
from yamsim_cli.core.attempt_data import FailureCause
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.checks.lowdim import expected_specs, frame_faults
from yamsim_cli.core.episode.attempt_payload import frame_records
from yamsim_cli.core.episode.episode_rules import EXPERT_RULES
from yamsim_cli.core.episode.execution import simulate_actions
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import invert_pose
from yamsim_cli.photos.overlay.photos import episode_photos

OBJECTS = ("banana", "plate")
LEFT, RIGHT = slice(0, 7), slice(7, 14)

Frames = list[dict[str, Any]]


def _config(make_config: Callable[..., RecordConfig], **keys: Any) -> RecordConfig:
    return make_config({("image", "size_px"): SIZE, ("seed",): 2} | {(key,): value for key, value in keys.items()})


def _frames(config: RecordConfig, locations: Locations) -> Frames:
    with Simulator(Session(config, locations)) as simulator:
        done = planned(simulator, config.seed, 1)
        assert done.outcome.success, done.outcome.detail
        return frame_records(simulator, done.attempt, done.recorded_states)


@pytest.fixture(scope="module")
def left(make_config: Callable[..., RecordConfig], locations: Locations) -> Frames:
    return _frames(_config(make_config, rig="bimanual", arm="left", wrist=True), locations)


@pytest.fixture(scope="module")
def right(make_config: Callable[..., RecordConfig], locations: Locations) -> Frames:
    return _frames(_config(make_config, rig="bimanual"), locations)


@pytest.fixture(scope="module")
def handover(make_config: Callable[..., RecordConfig]) -> RecordConfig:
    return _config(make_config, rig="russet", task="handover", wrist=True)


@pytest.fixture(scope="module")
def handed(handover: RecordConfig, locations: Locations) -> Frames:
    return _frames(handover, locations)


def test_commands_are_the_left_arms_first_and_physics_own_order_is_kept_beside(
    left: Frames, make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    """In this rig's model, the right arm comes first."""
    config = _config(make_config, rig="bimanual", arm="left", wrist=True)
    with Simulator(Session(config, locations)) as simulator:
        names = [simulator.scene.model.actuator(k).name for k in range(14)]
    assert names[0].startswith("arm2_") is False
    of_left = [k for k, name in enumerate(names) if name.startswith("arm2_")]
    ctrl, first = _column(left, "ctrl"), np.array([frame["sim_ctrl"][0] for frame in left], np.float32)
    np.testing.assert_array_equal(ctrl[:, LEFT], first[:, of_left])
    np.testing.assert_array_equal(ctrl[:, RIGHT], first[:, [k for k in range(14) if k not in of_left]])
    # The same holds for the joints.
    assert np.abs(ctrl - _column(left, "action_joints")).max() < 0.4


def _column(recorded: Frames, key: str, part: Any = ...) -> np.ndarray:
    return np.array([frame[key] for frame in recorded])[:, part]


@pytest.mark.parametrize(("side", "acts", "rests"), [("left", LEFT, RIGHT), ("right", RIGHT, LEFT)])
def test_one_arm_acts_and_the_other_one_holds_its_place(
    side: str, acts: slice, rests: slice, request: pytest.FixtureRequest
) -> None:
    frames: Frames = request.getfixturevalue(side)
    joints = _column(frames, "joints")
    assert joints.shape == (len(frames), 14)
    assert np.ptp(joints[:, acts], axis=0)[:3].min() > 0.1
    assert np.ptp(joints[:, rests], axis=0).max() < 0.02
    magnet = _column(frames, "magnet")
    number = 0 if side == "left" else 1
    assert magnet[:, number].any()
    assert not magnet[:, 1 - number].any()
    np.testing.assert_allclose(_column(frames, "action_joints")[:, rests], joints[:, rests], atol=0.02)


def test_either_arm_does_the_very_same_before_its_own_base(left: Frames, right: Frames) -> None:
    """The regions move with the arm, so the same attempt has the same motion."""
    np.testing.assert_allclose(_column(left, "joints")[:, LEFT], _column(right, "joints")[:, RIGHT], atol=1e-3)
    apart = _column(left, "banana_pose") - _column(right, "banana_pose")
    np.testing.assert_allclose(apart[:, 1, 3], 0.7, atol=1e-3)


def test_a_frame_of_two_arms_has_the_left_one_first_and_all_poses_in_its_base(left: Frames) -> None:
    cameras = ("scene_camera", "left_wrist_camera")
    first = left[0]
    assert frame_faults(first, expected_specs(OBJECTS, cameras, 2, 7)) == []
    assert frame_faults(first, expected_specs(OBJECTS, cameras, 1, 7)) != []
    assert (first["ctrl"].shape, first["ee_pose"].shape, first["magnet"].shape) == ((14,), (2, 4, 4), (2,))
    assert first["sim_magnet"].shape == (2, 2)
    np.testing.assert_allclose(first["T_right_base_in_left_base"][:3, 3], (0, -0.7, 0), atol=1e-6)
    np.testing.assert_allclose(first["T_right_base_in_left_base"][:3, :3], np.eye(3), atol=1e-6)
    held = next(frame for frame in left if frame["magnet"][0])
    assert np.linalg.norm((invert_pose(held["ee_pose"][0]) @ held["banana_pose"])[:3, 3]) < 0.06
    assert held["ee_pose"][1, 1, 3] == pytest.approx(-0.7, abs=0.05)
    looks_from = first["extrinsics"]["left_wrist_camera"][:3, 3] - first["ee_pose"][0, :3, 3]
    assert np.linalg.norm(looks_from) < 0.2
    assert set(first["intrinsics"]) == set(cameras)
    assert "K_wrist" in first


def test_simulation_data_of_another_number_of_arms_are_a_fault(left: Frames) -> None:
    cameras = ("scene_camera", "left_wrist_camera")
    for magnet in (np.ones(2, bool), np.ones((2, 3), bool)):
        (fault,) = frame_faults(left[0] | {"sim_magnet": magnet}, expected_specs(OBJECTS, cameras, 2, 7))
        assert "sim_magnet" in fault


def _held(ticks: np.ndarray) -> tuple[int, int]:
    """First and last tick at which a hand holds something, without a break."""
    held = np.flatnonzero(ticks)
    np.testing.assert_array_equal(held, np.arange(held[0], held[-1] + 1))
    return int(held[0]), int(held[-1])


def test_the_right_hand_holds_then_both_then_the_left_one(handed: Frames) -> None:
    ticks = np.concatenate([frame["sim_magnet"] for frame in handed])
    left, right = (_held(ticks[:, column]) for column in (0, 1))
    assert 0 < right[0] < left[0] <= right[1] < left[1] < len(ticks) - 1


def test_the_banana_goes_from_one_arm_to_the_other_in_the_air_and_level(handed: Frames) -> None:
    poses = _column(handed, "banana_pose")
    # Of russet: the right arm stands at y = -0.591 in the left one's base.
    assert poses[0, 1, 3] < -0.591 + 0.18
    assert abs(poses[-1, 1, 3]) < 0.18 + 0.05
    both = _column(handed, "magnet").all(axis=1)
    assert both.any()
    np.testing.assert_allclose(poses[both][:, 1, 3], -0.591 / 2, atol=0.06)
    assert (poses[both][:, 2, 3] > 0.08).all()
    carried = _column(handed, "magnet").any(axis=1)
    assert poses[carried][:, 2, 2].min() > np.cos(np.radians(5))


def test_both_wrists_are_recorded_of_a_hand_over(handed: Frames) -> None:
    cameras = ("scene_camera", "left_wrist_camera", "right_wrist_camera")
    assert set(handed[0]["extrinsics"]) == set(cameras)
    assert frame_faults(handed[0], expected_specs(OBJECTS, cameras, 2, 7)) == []
    # The key would not tell of which arm it is.
    assert "K_wrist" not in handed[0]


@pytest.mark.slow
def test_arms_that_meet_fail_the_attempt(handover: RecordConfig, locations: Locations) -> None:
    with Simulator(Session(handover, locations)) as simulator:
        done = planned(simulator, handover.seed, 1)
        actions = all_actions(done.recorded_states)
        # While the hands are together, the left arm turns towards the right one.
        ctrl, (begin, _) = actions.ctrl.copy(), _held(actions.magnet[:, 0])
        ctrl[begin : begin + 25, simulator.scene.arms[0].arm_ctrl[0]] -= np.linspace(0, 0.8, 25)
        outcome = simulate_actions(simulator, done.attempt, replace(actions, ctrl=ctrl), EXPERT_RULES).outcome
    assert outcome.cause is FailureCause.COLLIDED
    assert "arm2_" in outcome.detail


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory, handover: RecordConfig, locations: Locations) -> Path:
    path = tmp_path_factory.mktemp("handover") / "dataset"
    write_dataset(path, handover.model_copy(update={"wrist": False}), locations, 1)
    return path


@pytest.mark.slow
def test_a_recorded_camera_is_given_in_the_first_arms_base(dataset: Path, handover: RecordConfig) -> None:
    photo = episode_photos(dataset / "ep_000000", None, handover.rig)[0]
    frame = read_frame(dataset / "ep_000000", 0)
    T_right_in_cam = invert_pose(frame["extrinsics"]["scene_camera"]) @ frame["T_right_base_in_left_base"]
    np.testing.assert_allclose(photo.T_base_in_cam, T_right_in_cam, atol=1e-5)
    assert photo.postures is not None
    stands = [[*stand.joints, stand.opening] for stand in photo.postures]
    np.testing.assert_allclose(stands, [frame["joints"][RIGHT], frame["joints"][LEFT]], atol=1e-6)


@pytest.mark.slow
def test_summarize_accepts_two_arms_and_checks_both(dataset: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(dataset, tmp_path / "dataset")
    frame = read_frame(copy / "ep_000000", 3)
    joints, hands = frame["joints"].copy(), frame["ee_pose"].copy()
    joints[13] = 0.2
    hands[1, 0, 0] = 7.0
    clean = yamsim("summarize", copy, "--json").json["problems"]
    change_frame(copy / "ep_000000", 3, rehash=True, joints=joints, ee_pose=hands)
    found = yamsim("summarize", copy, "--json").json["problems"]
    # The images are fake, and there is neither ledger nor manifest.
    errors = {problem["code"] for problem in clean if problem["severity"] == "error"}
    assert errors <= {"ledger.missing", "image.frozen"}
    new = {problem["code"]: problem for problem in found if problem not in clean}
    assert {"joints.limit", "pose.rotation"} <= set(new)
    assert "ee_pose[1]" in str(new["pose.rotation"])
