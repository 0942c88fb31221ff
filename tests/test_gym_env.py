"""The gymnasium environment: gymnasium's own checker, and the same trials as the batch."""

from __future__ import annotations

import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.attempts import all_actions, planned
from tests.programs import ONTO_PLATE, changed, first_attempt, session_of, written
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.attempt_payload import frame_records
from yamsim_cli.core.episode.execution import simulate_expert
from yamsim_cli.core.episode.simulator import Simulator, SimulatorCache
from yamsim_cli.core.errors import SimulationError

gymnasium = pytest.importorskip("gymnasium", reason="yamsim[gym] is not installed")

from yamsim_cli.core.config.recording import RecordConfig  # noqa: E402
from yamsim_cli.core.files.resources import Locations  # noqa: E402
from yamsim_cli.gym_env import ENV_ID  # noqa: E402


@pytest.fixture
def env() -> Iterator[Any]:
    made = gymnasium.make(ENV_ID)
    yield made
    made.close()


def check(**options: Any) -> None:
    from gymnasium.utils.env_checker import check_env

    made = gymnasium.make(ENV_ID, **options)
    try:
        with warnings.catch_warnings():
            # Joints have their own bounds, and not -1..1.
            warnings.filterwarnings("ignore", message=".*(Box action space|normalized).*")
            check_env(made.unwrapped)
    finally:
        made.close()


def test_gymnasiums_checker_passes_it() -> None:
    check()


@pytest.mark.slow
@pytest.mark.render
def test_gymnasiums_checker_passes_it_with_images() -> None:
    check(observation="images", render_mode="rgb_array", size=(64, 48))


def test_the_plans_actions_succeed_from_the_batchs_start(env: Any, config: RecordConfig, locations: Locations) -> None:
    """A trial of the batch, replayed through the environment: the same states, success once, and a reward of 1."""
    with Simulator(Session(config, locations)) as simulator:
        done = planned(simulator, 5, 2)
        recorded = frame_records(simulator, done.attempt, done.recorded_states)
    assert recorded
    observation, info = env.reset(seed=5, options={"trial": 2})
    assert (info["seed"], info["trial"], info["success"]) == (5, 2, False)
    rewards, over, tick = 0.0, False, 0
    for state, frame in zip(done.recorded_states, recorded, strict=True):
        np.testing.assert_allclose(observation["joints"], frame["joints"], atol=1e-5)
        np.testing.assert_allclose(observation["object_pose_world"][:3, 3], frame["banana_pose"][:3, 3], atol=1e-4)
        for ctrl, magnet in zip(state.actions.ctrl, state.actions.magnet, strict=True):
            observation, reward, over, truncated, info = env.step(np.append(ctrl, magnet).astype(np.float32))
            rewards, tick = rewards + reward, tick + 1
            if over:
                break
        if over:
            break
    assert (rewards, over, truncated, info["success"], info["holds"]) == (1.0, True, False, True, False)
    # It holds still at first, and the arm returns afterwards.
    released = int(np.flatnonzero(all_actions(done.recorded_states).magnet)[-1]) + 1
    assert released + config.task.hold_ticks < tick <= sum(len(state.actions.ctrl) for state in done.recorded_states)


@pytest.mark.slow
def test_two_arms_hand_over(make_config: Callable[..., RecordConfig], locations: Locations) -> None:
    config = make_config({("rig",): "russet", ("task",): "handover", ("seed",): 2})
    with Simulator(Session(config, locations)) as simulator:
        actions = all_actions(planned(simulator, 2, 1).recorded_states)
        drives = simulator.scene.recorded_drive_ctrl.ravel()
    env = gymnasium.make(ENV_ID, rig="russet", task="handover")
    assert (env.action_space.shape, env.observation_space["ee_pose_world"].shape) == ((16,), (2, 4, 4))
    observation, _ = env.reset(seed=2, options={"trial": 1})
    assert env.observation_space.contains(observation)
    done = False
    for ctrl, magnet in zip(actions.ctrl, actions.magnet, strict=True):
        _, _, done, truncated, info = env.step(np.array([*ctrl[drives], *magnet], np.float32))
        assert not truncated
        if done:
            break
    env.close()
    assert done and info["success"]


@pytest.mark.slow
def test_a_task_that_is_data_is_one_too(tmp_path: Path) -> None:
    """Its expert's actions, replayed through the environment, reach the goal; object poses are named by roles."""
    task = str(written(tmp_path, ONTO_PLATE))
    check(task=task)
    with SimulatorCache(session_of(tmp_path, ONTO_PLATE)) as simulators:
        simulator, attempt = first_attempt(simulators, 1)
        done = simulate_expert(simulator, attempt)
    assert done.outcome.success and attempt.layout is not None
    env = gymnasium.make(ENV_ID, task=task)
    observation, info = env.reset(seed=0, options={"trial": 1})
    for name, T in attempt.layout.T_in_world.items():
        np.testing.assert_allclose(observation[f"{name}_pose_world"], T, atol=1e-5)
    assert info["prompt"] == attempt.phrasing and info["goal"]["on(cube, plate)"] < 0
    drives, over = simulator.scene.recorded_drive_ctrl[0], False
    for ctrl in all_actions(done.recorded_states).ctrl:
        observation, reward, over, truncated, info = env.step(np.append(ctrl[drives], 0.0).astype(np.float32))
        assert not truncated and (over == (reward == 1.0))
        if over:
            break
    env.close()
    assert over and info["success"] and info["goal"]["on(cube, plate)"] > 0


def test_joints_of_things_are_told(tmp_path: Path) -> None:
    env = gymnasium.make(ENV_ID, task="drawer")
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    assert observation["cabinet_joints"].shape == (1,) and observation["joints"].shape == (14,)
    env.close()


def test_a_task_without_a_start_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("yamsim_cli.policies.evaluate.stepped_task.MAX_SKIPPED_TRIALS", 1)
    tight = changed({("starts", "cube", "x"): [0.40, 0.40], ("starts", "cube", "y"): [-0.15, -0.15]})
    env = gymnasium.make(ENV_ID, task=str(written(tmp_path, tight)))
    with pytest.raises(SimulationError, match="of 1 trials of seed 3, from number 0 on, none has a start"):
        env.reset(seed=3)
    env.close()


@pytest.mark.parametrize(("keywords", "ticks"), [({}, 625), ({"max_ticks": 228}, 228)])
def test_an_episode_without_motion_is_truncated_at_its_time_limit(
    config: RecordConfig, keywords: dict[str, int], ticks: int
) -> None:
    """The environment truncates the episode at the task's time limit, or after `max_ticks`."""
    assert config.task.max_ticks == 625
    env = gymnasium.make(ENV_ID, **keywords)
    observation, _ = env.reset(seed=1)
    action = np.append(observation["joints"], 0.0).astype(np.float32)
    for _ in range(ticks - 1):
        _, reward, done, truncated, _ = env.step(action)
        assert (reward, done, truncated) == (0.0, False, False)
    assert env.step(action)[1:4] == (0.0, False, True)


def test_seeds_decide_the_layout_and_resets_go_on(env: Any) -> None:
    first = env.reset(seed=7)
    second = env.reset()
    assert [found[1]["trial"] for found in (first, second)] == [0, 1]
    again = env.reset(seed=7)
    np.testing.assert_array_equal(again[0]["object_pose_world"], first[0]["object_pose_world"])
    assert np.abs(second[0]["object_pose_world"] - first[0]["object_pose_world"]).max() > 1e-3
    np.testing.assert_array_equal(
        env.reset(seed=7, options={"trial": 1})[0]["object_pose_world"], second[0]["object_pose_world"]
    )
    other = gymnasium.make(ENV_ID)
    assert other.reset()[1]["seed"] != gymnasium.make(ENV_ID).reset()[1]["seed"]
    other.close()


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_environments_run_vectorized(mode: str) -> None:
    envs = gymnasium.make_vec(ENV_ID, num_envs=2, vectorization_mode=mode)
    try:
        observation, _ = envs.reset(seed=3)
        assert observation["joints"].shape == (2, 7)
        assert np.abs(observation["object_pose_world"][0] - observation["object_pose_world"][1]).max() > 1e-3
        _, rewards, *_ = envs.step(envs.action_space.sample())
        assert rewards.shape == (2,)
    finally:
        envs.close()


@pytest.mark.render
def test_the_environment_renders() -> None:
    made = gymnasium.make(ENV_ID, render_mode="rgb_array", size=(80, 60))
    made.reset(seed=0)
    image = made.render()
    made.close()
    assert (image.shape, image.dtype) == ((60, 80, 3), np.uint8)
    assert image.std() > 5


def test_invalid_arguments_and_actions_are_refused(env: Any) -> None:
    for options in ({"render_mode": "ansi"}, {"observation": "pixels"}):
        with pytest.raises((ValueError, gymnasium.error.Error)):
            gymnasium.make(ENV_ID, **options)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="8 finite numbers"):
        env.unwrapped.step(np.full(8, np.nan))


@pytest.mark.parametrize("lines", ["import gymnasium, yamsim_cli", "import yamsim_cli.gym_env, gymnasium"])
def test_importing_registers_it(lines: str, repository: Path) -> None:
    code = f"{lines}; gymnasium.spec('{ENV_ID}')"
    subprocess.run([sys.executable, "-c", code], cwd=repository, check=True)


def test_the_command_line_does_without(repository: Path) -> None:
    code = "import sys, yamsim_cli.main; sys.exit('gymnasium' in sys.modules or 'numpy' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], cwd=repository, check=True)


def test_a_goal_of_cloth_is_looked_at() -> None:
    env = gymnasium.make(ENV_ID, task="fold_napkin")
    observation, info = env.reset(seed=0)
    assert observation["napkin_pose_world"].shape == (4, 4)
    # It lies flat: points that belong together are 0.2 m apart, its length, and count as folded within 0.02 m.
    assert info["goal"]["folded(napkin, half)"] == pytest.approx(0.02 - 0.2, abs=1e-3)
    *_, info = env.step(np.append(observation["joints"], (0.0, 0.0)).astype(np.float32))
    assert info["goal"]["folded(napkin, half)"] < 0 and not info["success"]
    env.close()
