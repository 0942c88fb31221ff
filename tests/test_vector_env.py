"""The vector environment does what gymnasium's `SyncVectorEnv` of single environments does, bit for bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="yamsim[gym] is not installed")

from yamsim_cli.core.errors import UsageError  # noqa: E402
from yamsim_cli.gym_env import ENV_ID  # noqa: E402

COUNT = 3  # environments


def require_equal(one: Any, other: Any, where: str = "") -> None:
    """Fail unless two nested results are equal bit for bit."""
    if isinstance(one, dict):
        assert one.keys() == other.keys(), where
        for key in one:
            require_equal(one[key], other[key], f"{where}/{key}")
    elif isinstance(one, tuple) or (isinstance(one, np.ndarray) and one.dtype == object):
        for k, (left, right) in enumerate(zip(one, other, strict=True)):
            require_equal(left, right, f"{where}[{k}]")
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype, where
        np.testing.assert_array_equal(one, other, err_msg=where)
    else:
        assert one == other, where


def reaching_actions(env: Any, observation: dict[str, Any], rng: np.random.Generator) -> np.ndarray:
    """Return actions near the present joints, with random welds."""
    joints = observation["joints"] + rng.normal(0.0, 0.2, observation["joints"].shape)
    welds = rng.uniform(size=(len(joints), env.single_action_space.shape[0] - joints.shape[1]))
    return np.concatenate([joints, welds], axis=1).astype(np.float32)


def require_same_as_single(ticks: int, mode: str = "NextStep", count: int = COUNT, **options: Any) -> None:
    """Fail unless a vector environment and a `SyncVectorEnv` of single ones return the same at each step."""
    single = gymnasium.make_vec(
        ENV_ID, num_envs=count, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}, **options
    )
    many = gymnasium.make_vec(ENV_ID, num_envs=count, autoreset_mode=mode, threads=2, **options)
    try:
        assert (many.single_observation_space, many.action_space) == (
            single.single_observation_space,
            single.action_space,
        )
        expected, found = single.reset(seed=4), many.reset(seed=4)
        require_equal(expected, found)
        rng = np.random.default_rng(0)
        for tick in range(ticks):
            actions = reaching_actions(many, found[0], rng)
            expected, found = single.step(actions), many.step(actions)
            for one, other in zip(expected, found, strict=True):
                require_equal(one, other, f"tick {tick}")
    finally:
        single.close()
        many.close()


@pytest.mark.parametrize(
    ("ticks", "options"),
    [
        (40, {"max_ticks": 15, "reach": "object"}),
        pytest.param(20, {"task": "handover", "rig": "russet", "max_ticks": 12}, marks=pytest.mark.slow),
        pytest.param(12, {"task": "drawer", "max_ticks": 8}, marks=pytest.mark.slow),
        pytest.param(12, {"task": "cans_into_bin", "max_ticks": 8}, marks=pytest.mark.slow),
        pytest.param(4, {"task": "fold_napkin", "max_ticks": 3}, marks=pytest.mark.slow),
    ],
)
def test_it_equals_single_environments(ticks: int, options: dict[str, Any]) -> None:
    require_same_as_single(ticks, **options)


def test_final_observations_come_in_the_same_step() -> None:
    require_same_as_single(12, "SameStep", max_ticks=5)


@pytest.mark.render
def test_images_equal_those_of_single_environments() -> None:
    require_same_as_single(3, count=2, observation="images", size=(64, 48), max_ticks=2)


def test_results_do_not_depend_on_the_number_of_threads() -> None:
    results = []
    for threads in (1, 2, 5):
        env = gymnasium.make_vec(ENV_ID, num_envs=8, threads=threads, max_ticks=20)
        rng, run = np.random.default_rng(1), [env.reset(seed=0)]
        for _ in range(30):
            run.append(env.step(reaching_actions(env, run[-1][0], rng)))
        env.close()
        results.append(run)
    for other in results[1:]:
        for one, two in zip(results[0], other, strict=True):
            for left, right in zip(one, two, strict=True):
                require_equal(left, right)


def test_seeds_trials_and_masks_choose_what_is_reset() -> None:
    env = gymnasium.make_vec(ENV_ID, num_envs=3, autoreset_mode="Disabled", max_ticks=1)
    with pytest.raises(ValueError, match="needs a `reset`"):
        env.step(np.zeros((3, 8), np.float32))
    observation, info = env.reset(seed=[5, 9, 5], options={"trial": 2})
    assert (info["seed"].tolist(), info["trial"].tolist()) == ([5, 9, 5], [2, 2, 2])
    np.testing.assert_array_equal(observation["object_pose_world"][0], observation["object_pose_world"][2])
    actions = np.concatenate([observation["joints"], np.zeros((3, 1))], axis=1).astype(np.float32)
    assert env.step(actions)[3].all()
    with pytest.raises(ValueError, match=r"environments \[0, 1, 2\] are over"):
        env.step(actions)
    _, info = env.reset(options={"reset_mask": np.array([True, False, True])})
    assert (info["trial"].tolist(), info["_trial"].tolist()) == ([3, 0, 3], [True, False, True])
    with pytest.raises(ValueError, match=r"environments \[1\] are over"):
        env.step(actions)
    env.close()


def test_broken_physics_ends_only_its_environment() -> None:
    env = gymnasium.make_vec(ENV_ID, num_envs=2)
    observation, _ = env.reset(seed=0)
    actions = np.concatenate([observation["joints"], np.zeros((2, 1))], axis=1).astype(np.float32)
    env.unwrapped._trial(1).episode.data.qvel[:] = np.inf
    _, rewards, terminated, truncated, info = env.step(actions)
    assert (rewards.tolist(), terminated.tolist(), truncated.tolist()) == ([0, 0], [False, True], [False, False])
    assert not info["success"].any()
    assert "physics broke down within 0.032 s" in env.unwrapped._trial(1).episode.end.detail
    env.close()


def test_the_reward_of_reaching_is_the_distance() -> None:
    env = gymnasium.make_vec(ENV_ID, num_envs=2, reach="object")
    observation, _ = env.reset(seed=0)
    actions = np.concatenate([observation["joints"], np.zeros((2, 1))], axis=1).astype(np.float32)
    observation, rewards, *_, info = env.step(actions)
    off = observation["ee_pose_world"][:, :3, 3] - observation["object_pose_world"][:, :3, 3]
    np.testing.assert_allclose(rewards, -np.linalg.norm(off, axis=1), atol=1e-6)
    np.testing.assert_array_equal(info["reach"], -rewards)
    env.close()


def test_invalid_arguments_are_refused() -> None:
    for options in ({"num_envs": 0}, {"threads": 0}, {"autoreset_mode": "Sometimes"}, {"observation": "pixels"}):
        with pytest.raises(ValueError, match=r"not valid|not a valid"):
            gymnasium.make_vec(ENV_ID, **options)
    with pytest.raises(UsageError, match="reach 'objekt' is not an object of task 'pickplace'"):
        gymnasium.make_vec(ENV_ID, reach="objekt")
    env = gymnasium.make_vec(ENV_ID, num_envs=2)
    with pytest.raises(ValueError, match="2 environments"):
        env.reset(seed=[1])
    with pytest.raises(ValueError, match="reset_mask"):
        env.reset(options={"reset_mask": np.array([1, 0])})
    env.reset(seed=0)
    with pytest.raises(ValueError, match="8 finite numbers"):
        env.step(np.zeros((3, 8), np.float32))
    env.close()
