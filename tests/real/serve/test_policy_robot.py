"""Arms driven by raiden's policies: from action to action, home again, and stopped at an action that is too far."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tests.real.serve.shots import FakeRenderProcess
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.real.serve.policy_robot import PolicyRobot, pose_from_rotation_rows
from yamsim_cli.real.serve.served_arms import ServedArms, make_policy_robot, serve_arms

STATION = "yam_station_linear_4310_d405"
HOME = np.tile([0, 0, 0, 0, 0, 0, 1.0], 2)


@pytest.fixture(scope="module")
def session(make_config: Callable[..., RecordConfig], locations: Locations) -> Session:
    return Session(make_config({("rig",): STATION}), locations)


class Driven:
    """A robot and its time."""

    def __init__(self, session: Session) -> None:
        self.served: ServedArms = serve_arms(session)
        self.shots = FakeRenderProcess()
        self.robot: PolicyRobot = make_policy_robot(session, self.served, self.shots)  # type: ignore[arg-type]

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / self.served.motor_simulation.timestep)):
            self.robot.command_next_step()
            for follower in self.served.followers:
                follower.command_motors()
            self.served.motor_simulation.step()

    def row(self) -> np.ndarray:
        return np.concatenate([follower.joint_pos() for follower in self.served.followers])

    def see(self, number: int = 0) -> dict[str, np.ndarray]:
        self.shots.joints = tuple(follower.joint_pos() for follower in self.served.followers)
        self.shots.take(number)
        assert self.shots.newest_frames is not None
        return dict(self.robot.observe(self.shots.newest_frames).proprios)


@pytest.fixture
def driven(session: Session) -> Driven:
    made = Driven(session)
    made.robot.reset()
    assert made.robot.is_going_home
    made.run(2.2)
    assert not made.robot.is_going_home
    return made


def test_it_goes_home_along_joints_and_by_its_hands_poses(driven: Driven) -> None:
    np.testing.assert_allclose(driven.row(), HOME, atol=0.02)
    goal = HOME.copy()
    goal[[1, 2, 6, 8, 9]] += 0.6, 0.6, -0.5, 0.4, 0.4
    for share in np.linspace(0.1, 1, 10):
        driven.robot.queue_action((1 - share) * HOME + share * goal)
        driven.run(0.1)
    driven.run(0.5)
    assert driven.robot.stop_reason == ""
    np.testing.assert_allclose(driven.row(), goal, atol=0.02)
    # 3 cm up, with the same hands: ten numbers per arm.
    felt = driven.see()
    key = "robot__actual__poses__{}::yam__{}".format
    xyz, rows = (np.concatenate([felt[key(side, part)] for side in ("left", "right")]) for part in ("xyz", "rot_6d"))
    up = xyz + np.tile([0, 0, 0.03], 2)
    for share in np.linspace(0.25, 1, 4):
        driven.robot.queue_action(np.concatenate([(1 - share) * xyz + share * up, rows, [0.3, 0.8]]))
        driven.run(0.1)
    driven.run(0.5)
    felt = driven.see(1)
    there = np.concatenate([felt[key(side, "xyz")] for side in ("left", "right")])
    np.testing.assert_allclose(there, up, atol=0.003)
    np.testing.assert_allclose(felt["robot__actual__grippers__left::yam_hand"], 0.3, atol=0.02)
    np.testing.assert_allclose(felt["follower_r_joint_pos"][6], 0.8, atol=0.02)


def test_a_jump_stops_the_robot_until_the_next_reset(driven: Driven) -> None:
    far = HOME.copy()
    far[8] = 0.3
    driven.robot.queue_action(far)
    assert "joint 2 of the right arm to move by 0.3" in driven.robot.stop_reason
    before = driven.row()
    driven.robot.queue_action(HOME)
    driven.run(0.3)
    np.testing.assert_allclose(driven.row(), before, atol=0.01)
    driven.robot.reset()
    assert driven.robot.stop_reason == ""
    driven.run(2.1)
    far[8] = 0.1
    driven.robot.queue_action(far)
    driven.run(0.4)
    assert driven.row()[8] == pytest.approx(0.1, abs=0.02)


def test_actions_that_come_too_fast_are_discarded_and_counted(driven: Driven) -> None:
    for _ in range(40):
        driven.robot.queue_action(HOME)
    assert driven.robot.discarded_actions == 8


@pytest.mark.parametrize("numbers", [np.ones(13), np.full(14, np.nan), np.full(20, np.inf), np.zeros(20)])
def test_invalid_actions_are_refused(driven: Driven, numbers: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"an action has|give no rotation"):
        driven.robot.queue_action(numbers)
    assert driven.robot.stop_reason == ""


def test_cameras_have_raidens_names_and_squares(driven: Driven, session: Session) -> None:
    assert driven.robot.metadata["cameras"] == ["top", "left_wrist_camera"]
    driven.see()
    assert driven.shots.newest_frames is not None
    view = driven.robot.observe(driven.shots.newest_frames).views["left_wrist_camera"]
    assert view.picture.shape == (384, 384, 3)
    width, height = driven.shots.size
    np.testing.assert_allclose(np.diag(view.K), [7 * 384 / width, 7 * 384 / height, 1])


def test_a_rotation_is_made_of_any_two_rows() -> None:
    T = pose_from_rotation_rows(np.arange(3.0), np.array([2.0, 0, 0, 1, 3, 0]))
    np.testing.assert_allclose(T[:3, :3], np.eye(3), atol=1e-12)
    np.testing.assert_equal(T[:3, 3], np.arange(3.0))
