"""Object poses as a row of numbers: the same in an export, and in a policy's observation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.policy import PolicyConfig
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.environment_state import joints_key, make_state_row, object_pose_keys, state_names
from yamsim_cli.core.episode.attempt_payload import frame_records
from yamsim_cli.core.episode.episode_rules import EpisodeRules
from yamsim_cli.core.episode.execution import simulate_expert
from yamsim_cli.core.episode.sampling import sample_attempt
from yamsim_cli.core.episode.simulator import SimulatorCache, open_episode
from yamsim_cli.core.errors import UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import pose, rotation_z
from yamsim_cli.policies.evaluate.observation import ObservationBuilder, ObservationRenderer
from yamsim_cli.policies.evaluate.policy_factory import policy_station
from yamsim_cli.policies.external_policy import MappedPolicy
from yamsim_cli.policies.lerobot import check_rows


class StateOnlyClient:
    """A client that only receives observations."""

    def begin_trial(self, seed: int) -> None: ...

    def infer(self, message: object) -> dict[str, object]:
        return {}

    def close(self) -> None: ...


def test_a_row_has_a_position_two_axes_and_joints() -> None:
    turned = pose((1.0, 2.0, 3.0), rotation_z(np.pi / 2))
    row = make_state_row([(turned, ()), (np.eye(4), (0.25,))])
    np.testing.assert_allclose(row, [1, 2, 3, 0, 1, 0, -1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0.25], atol=1e-12)
    names = state_names(("cup", "cabinet"), {"cabinet": ("slide",)})
    assert len(names) == len(row) == len(set(names))
    assert [names[k] for k in (0, 4, 6, 8, 9, 18)] == [
        "cup_x", "cup_x_axis_y", "cup_y_axis_x", "cup_y_axis_z", "cabinet_x", "cabinet_joint_slide"
    ]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rig", "task", "grasp", "things", "width"),
    [
        ("single", "pickplace", "weld", ["banana", "plate"], 18),
        # The base is not at the world's origin.
        ("russet", "handover", "weld", ["banana", "plate"], 18),
        ("yam_station_linear_4310_d405", "drawer", "contact", ["cabinet", "cube"], 19),
    ],
)
def test_a_policy_is_told_what_an_export_would_hold(
    rig: str,
    task: str,
    grasp: str,
    things: list[str],
    width: int,
    make_config: Callable[..., RecordConfig],
    locations: Locations,
) -> None:
    config = make_config({("rig",): rig, ("task",): task, ("grasp",): grasp})
    mapping = load_config(PolicyConfig, "policies", "lerobot_export", locations)
    policy = MappedPolicy(StateOnlyClient(), mapping, policy_station(config), ["observation.environment_state"])
    assert (policy.wants, policy.images) == (("objects",), ())
    assert sorted(object_pose_keys(config)) == things
    with SimulatorCache(Session(config, locations)) as simulators:
        job = AttemptJob(0, 0)
        simulator = simulators.get(job)
        done = simulate_expert(simulator, sample_attempt(simulator, job))
        (frame,) = frame_records(simulator, done.attempt, done.recorded_states[-1:])
        episode = open_episode(simulator, replace(done.attempt, start=done.recorded_states[-1].qpos), EpisodeRules())
        seen = ObservationBuilder(simulator, policy.images, policy.wants).observe(
            episode, done.attempt, ObservationRenderer(_nothing)
        )
        told = policy.make_message(seen)["observation.environment_state"]
    recorded = make_state_row(
        [(frame[f"{name}_pose"], frame.get(joints_key(name), ())) for name in object_pose_keys(config)]
    )
    assert (told.shape, told.dtype) == ((width,), np.float32)
    np.testing.assert_allclose(told, recorded, atol=1e-6)


def test_a_checkpoint_that_does_not_ask_is_not_told(config: RecordConfig, locations: Locations) -> None:
    mapping = load_config(PolicyConfig, "policies", "lerobot_export", locations)
    policy = MappedPolicy(StateOnlyClient(), mapping, policy_station(config), ["observation.state"])
    assert policy.wants == ()
    message = policy.make_message({"joints": np.zeros(7), "prompt": "do it", "time": 0.0})
    assert set(message) == {"observation.state", "task"}


def test_a_checkpoint_of_another_task_is_told() -> None:
    asked = {"observation.state": (7,), "observation.environment_state": (27,)}
    message = {"observation.state": np.zeros(7), "observation.environment_state": np.zeros(18), "task": "do it"}
    with pytest.raises(
        UsageError, match="environment_state has 18 numbers here, and 27 in the training data of the policy"
    ):
        check_rows(message, asked)
    check_rows(message, asked | {"observation.environment_state": (18,)})


def _nothing(qpos: object, camera: str) -> np.ndarray:
    raise AssertionError(f"{camera} is rendered")
