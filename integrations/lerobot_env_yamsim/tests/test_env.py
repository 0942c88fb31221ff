"""The environments by themselves, where LeRobot is installed: `pytest integrations/lerobot_env_yamsim`."""

from __future__ import annotations

import json
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from lerobot.configs import FeatureType
from lerobot.envs import make_env, make_env_config
from lerobot.envs.utils import env_to_policy_features, preprocess_observation
from lerobot_env_yamsim import YamsimEnv, YamsimEnvConfig
from lerobot_env_yamsim.environment import Rate, rate_of

from yamsim_cli.station import Station

SMALL = {"size": "32x24", "quality": "fast"}


@pytest.fixture(scope="module")
def envs() -> Iterator[Any]:
    made = make_env(YamsimEnvConfig(**SMALL, environment_state=True, max_frames=4), n_envs=2)["pickplace"][0]
    yield made
    made.close()


def test_policies_are_shown_what_an_export_has() -> None:
    features = env_to_policy_features(make_env_config("yamsim", **SMALL, environment_state=True))
    assert {key: (feature.type, tuple(feature.shape)) for key, feature in features.items()} == {
        "observation.state": (FeatureType.STATE, (7,)),
        "observation.environment_state": (FeatureType.ENV, (18,)),
        "observation.images.scene_camera": (FeatureType.VISUAL, (3, 24, 32)),
        "observation.images.right_wrist_camera": (FeatureType.VISUAL, (3, 24, 32)),
        "action": (FeatureType.ACTION, (8,)),
    }
    few = YamsimEnvConfig(action="joints", rig="single_linear", grasp="contact", fps=30, pictures=False)
    assert set(few.features) == {"agent_pos", "action"} and tuple(few.features["action"].shape) == (7,)


def test_observations_are_the_stations(envs: Any) -> None:
    seen, info = envs.reset(seed=[5, 6])
    assert list(info["trial"]) == [5, 6] and list(info["is_success"]) == [False, False]
    assert envs.call("task_description") == ("pick up the banana and put it on the plate",) * 2
    assert set(preprocess_observation(seen)) == set(env_to_policy_features(YamsimEnvConfig(environment_state=True))) - {
        "action"
    }
    with Station(YamsimEnvConfig(**SMALL).station_settings()["pickplace"]) as station:
        for number in (0, 1):
            station.begin(trial=5 + number)
            np.testing.assert_array_equal(seen["agent_pos"][number], station.state())
            np.testing.assert_array_equal(seen["environment_state"][number], station.environment())
            for camera, image in station.pictures().items():
                np.testing.assert_array_equal(seen["pixels"][camera][number], image)
    np.testing.assert_array_equal(envs.envs[0].render(), seen["pixels"]["scene_camera"][0])


def test_a_trial_ends_with_its_last_frame_and_stays_as_it_ended(envs: Any) -> None:
    seen, _ = envs.reset(seed=[0, 1], options={"lerobot_new_rollout": True})
    stay = np.concatenate([seen["agent_pos"], np.zeros((2, 1))], axis=1).astype(np.float32)
    for frame in range(1, 7):
        seen, reward, terminated, truncated, _ = envs.step(stay)
        assert not terminated.any() and not reward.any()
        # Afterwards gymnasium resets it, and LeRobot's wrapper keeps what there was.
        assert list(truncated) == [frame in (4, 6)] * 2


def test_an_action_that_is_none_costs_the_trial_alone(envs: Any) -> None:
    envs.reset(seed=[0, 1], options={"lerobot_new_rollout": True})
    actions = np.zeros((2, 8), np.float32)
    actions[1, 3] = np.nan
    _, _, terminated, _, info = envs.step(actions)
    assert list(terminated) == [False, True] and list(info["is_success"]) == [False, False]
    envs.reset(seed=[0, 1], options={"lerobot_new_rollout": True})
    assert not envs.step(np.zeros((2, 8), np.float32))[2].any()


def test_without_a_seed_the_next_trial_comes() -> None:
    env = YamsimEnv(YamsimEnvConfig(**SMALL).station_settings()["pickplace"], pictures=False)
    try:
        assert [env.reset(seed=seed)[1]["trial"] for seed in (None, 7, None)] == [0, 7, 8]
    finally:
        env.close()


def test_several_tasks_are_groups_of_their_own() -> None:
    made = make_env(YamsimEnvConfig(task="tower, set_upright", **SMALL), n_envs=1)
    assert {task: list(group) for task, group in made.items()} == {"tower": [0], "set_upright": [0]}
    assert made["tower"][0].call("task") == ("tower",)
    with pytest.raises(ValueError, match="objects differ"):
        YamsimEnvConfig(task="tower,set_upright", environment_state=True)


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"task": "towr"}, "--env.task: task: unknown task 'towr'; did you mean 'tower'"),
        ({"task": " ,"}, "--env.task is empty"),
        ({"task": "pickplace,tower"}, "one policy cannot do pickplace and tower"),
        ({"fps": 20}, "--env.fps: 20 frames a second"),
        ({"size": "9x9"}, "width and height must lie in"),
    ],
)
def test_settings_that_are_not_valid_are_told(settings: dict[str, Any], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        YamsimEnvConfig(**settings)


def test_rates_suit_json_and_videos() -> None:
    assert rate_of(30.0) == 30 and isinstance(rate_of(30.0), int)
    rate = rate_of(15.625)
    assert isinstance(rate, Rate) and json.dumps(rate) == "15.625"
    assert Fraction(rate.numerator, rate.denominator) == Fraction(125, 8)
