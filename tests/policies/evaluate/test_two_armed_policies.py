"""Policies for two arms: observations and answers, and that the plan's actions equal the batch's."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.unrendered import write_dataset
from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.episode_rules import EndRule
from yamsim_cli.core.errors import UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.policies.evaluate.evaluation import evaluate, evaluation_report
from yamsim_cli.policies.evaluate.observation import policy_cameras
from yamsim_cli.policies.evaluate.policy_choice import PolicyChoice
from yamsim_cli.policies.evaluate.policy_trial import TrialRunner
from yamsim_cli.policies.policy_protocol import SCENE, WRIST
from yamsim_cli.trials import run_expert_trials

HERE = Path(__file__).parent
SMALL = {("episodes",): 2, ("workers",): 1, ("wrist",): True, ("image", "size_px"): [48, 36]}

WATCHER = """
import numpy as np

SEEN = []


class Watcher:
    images = ()

    def reset(self):
        SEEN.clear()

    def __call__(self, observation):
        SEEN.append(observation)
        # The left gripper closes, and the right arm turns about its base.
        ctrl = observation["joints"].copy()
        ctrl[6], ctrl[7] = 0.0, ctrl[7] + 0.1
        return {"ctrl": ctrl, "magnet": [False, True], "done": len(SEEN) == 10}
"""


@pytest.fixture(scope="module")
def handover(make_config: Callable[..., RecordConfig]) -> RecordConfig:
    return make_config(SMALL | {("rig",): "russet", ("task",): "handover", ("seed",): 2})


@pytest.fixture(scope="module")
def left(make_config: Callable[..., RecordConfig]) -> RecordConfig:
    return make_config(SMALL | {("rig",): "bimanual", ("arm",): "left", ("seed",): 2})


@pytest.mark.parametrize("name", ["handover", "left"])
@pytest.mark.slow
def test_the_plans_actions_do_what_the_batch_does(
    name: str, locations: Locations, request: pytest.FixtureRequest
) -> None:
    config: RecordConfig = request.getfixturevalue(name)
    batch = run_expert_trials(Session(config, locations), (0.05,), lambda *_: None)
    found = evaluate(Session(config, locations), PolicyChoice("scripted", HERE, end=EndRule.ACTOR), lambda *_: None)
    report = json.loads(json.dumps(evaluation_report(found, config, (0.05,))))
    assert report["stats"]["n_success"] == 2
    assert [trial["outcome"] for trial in report["trials"]] == [trial["outcome"] for trial in batch["trials"]]


def test_a_datasets_actions_are_replayed(left: RecordConfig, locations: Locations, tmp_path: Path) -> None:
    write_dataset(tmp_path / "dataset", left, locations, 1)
    choice = PolicyChoice(f"replay:{tmp_path / 'dataset'}", HERE)
    with TrialRunner(Session(left, locations), choice) as runner:
        assert runner.run(AttemptJob(left.seed, 0)).outcome.success


def test_numbers_are_the_left_arms_first(left: RecordConfig, locations: Locations, tmp_path: Path) -> None:
    (tmp_path / "watcher.py").write_text(WATCHER)
    with TrialRunner(Session(left, locations), PolicyChoice("watcher.py:Watcher", tmp_path)) as runner:
        result = runner.run(AttemptJob(left.seed, 0))
        seen = runner.policy.__call__.__globals__["SEEN"]
        scene = runner.simulators.get(AttemptJob(0, 0)).scene
    first, last = seen[0], seen[-1]
    assert first["joints"].shape == (14,)
    assert first["ee_pose_world"].shape == (2, 4, 4)
    # In `world`, the left arm stands at positive y.
    assert first["ee_pose_world"][0, 1, 3] > 0.2
    assert first["ee_pose_world"][1, 1, 3] < -0.2
    np.testing.assert_array_equal(first["gripper"], first["joints"][[6, 13]])
    # The left arm acts, so its fingers were open.
    assert first["gripper"][0] > 0.02
    assert first["gripper"][1] < 0.01
    assert last["gripper"][0] < first["gripper"][0] - 0.01
    assert last["joints"][7] > first["joints"][7] + 0.1
    assert abs(last["joints"][0] - first["joints"][0]) < 0.02
    # No hand was near the banana.
    assert result.actions is not None
    assert not result.actions.magnet.any()
    ticks = 10 + left.task.timing.settle_ticks + left.task.hold_ticks
    assert result.actions.ctrl.shape == (ticks, scene.model.nu)
    assert (result.actions.magnet.shape, result.actions.joints.shape) == ((ticks, 2), (ticks, 2, 7))


def test_the_wrist_cameras_are_those_of_the_arms_that_act(
    handover: RecordConfig, left: RecordConfig, config: RecordConfig
) -> None:
    both = {"left_wrist_rgb": "left_wrist_camera", "right_wrist_rgb": "right_wrist_camera"}
    assert policy_cameras(handover, (SCENE, WRIST)) == {"scene_rgb": "scene_camera"} | both
    assert policy_cameras(handover, ("right_wrist",)) == {"right_wrist_rgb": "right_wrist_camera"}
    assert policy_cameras(left, (WRIST,)) == {"left_wrist_rgb": "left_wrist_camera"}
    assert policy_cameras(config, (WRIST,)) == {"wrist_rgb": "right_wrist_camera"}
    with pytest.raises(UsageError, match="'right_wrist', which rig 'bimanual'"):
        policy_cameras(left, ("right_wrist",))
