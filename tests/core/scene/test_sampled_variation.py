from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, fields
from typing import Any

import numpy as np
import pytest

from yamsim_cli.core.attempt_data import AttemptJob, Outcome
from yamsim_cli.core.config.randomization import SurfaceRanges
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.variation import RandomizationSample
from yamsim_cli.core.dataset.records import AttemptRecord, OutcomeRecord, from_json, to_json
from yamsim_cli.core.scene import randomization_sampling as sampled_variation
from yamsim_cli.core.scene.random_streams import Stream, random_generator
from yamsim_cli.core.scene.randomization_sampling import sample_randomization

JOB = AttemptJob(3, 5)
# Part -> sampled values that it alone uses; distractors' places are sampled elsewhere.
OWN = {
    "lights": {"lights"},
    "headlight": {"headlight"},
    "mass": {"mass"},
    "friction": {"friction"},
    "lens_deg": {"lens_deg"},
    "camera": {"camera"},
    "table": {"table"},
    "floor": {"floor"},
    "objects": {"looks"},
    "picture": {"noise", "salt_pepper"},
    "arm_dynamics": {"arm_dynamics"},
}
ARMS = {
    "command_delay_ms": [5, 30],
    "sensor_delay_ms": [0, 8],
    "sensor_noise_rad": [0.0001, 0.0005],
    "encoder_step_rad": [0.0001, 0.0004],
    "gravity_error": [-0.05, 0.05],
}


@pytest.fixture(scope="module")
def randomized(make_config: Callable[..., RecordConfig]) -> RecordConfig:
    return make_config({("randomization",): "default", ("randomization", "arm_dynamics"): ARMS})


def sampled(config: RecordConfig, job: AttemptJob = JOB, **changes: Any) -> RandomizationSample:
    ranges = config.randomization.model_copy(update=changes)
    return sample_randomization(ranges, job, config.scene.lights, config.task.objects, (6,))


def test_nothing_is_drawn_of_what_is_left_out(config: RecordConfig, randomized: RecordConfig) -> None:
    assert set(randomized.randomization.varied_parts) == {*OWN, "distractors"}
    assert config.randomization.varied_parts == ()
    assert sampled(config) == RandomizationSample()


def test_the_same_attempt_draws_the_same(randomized: RecordConfig) -> None:
    assert sampled(randomized) == sampled(randomized)
    for other in (AttemptJob(3, 6), AttemptJob(4, 5)):
        one, two = asdict(sampled(randomized)), asdict(sampled(randomized, other))
        same = {key for key, value in one.items() if value == two[key]}
        assert same == {"distractors", "pushes", "walls"}  # pushes are sampled with the disturbances


@pytest.mark.parametrize("part", OWN)
def test_leaving_a_part_out_leaves_the_others_draws_alone(randomized: RecordConfig, part: str) -> None:
    whole, less = asdict(sampled(randomized)), asdict(sampled(randomized, **{part: None}))
    assert {key for key in whole if whole[key] != less[key]} == OWN[part]
    assert not any(less[key] for key in OWN[part])


def test_distractors_change_no_other_draw_but_have_looks_of_their_own(randomized: RecordConfig) -> None:
    whole, less = sampled(randomized), sampled(randomized, distractors=None)
    assert {name: whole.looks[name] for name in less.looks} == less.looks
    assert list(less.looks) == ["banana", "plate"]
    assert "apple" in whole.looks


def test_no_two_parts_share_a_stream(randomized: RecordConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    used: list[Stream] = []

    def noted(job: AttemptJob, stream: Stream) -> np.random.Generator:
        used.append(stream)
        return random_generator(job, stream)

    monkeypatch.setattr(sampled_variation, "random_generator", noted)
    sampled(randomized)
    assert len(used) == len(set(used)) == 12


def test_draws_stay_in_their_ranges_and_fill_them(randomized: RecordConfig) -> None:
    ranges = randomized.randomization
    draws = [sampled(randomized, AttemptJob(0, k)) for k in range(300)]
    assert ranges.mass
    assert ranges.lens_deg
    assert ranges.camera
    assert ranges.lights
    assert ranges.table
    masses = np.array([d.mass["banana"] for d in draws])
    assert ranges.mass[0] <= masses.min() < ranges.mass[0] + 0.02
    assert ranges.mass[1] - 0.02 < masses.max() <= ranges.mass[1]
    assert abs(np.median(np.log(masses))) < 0.05
    lens = np.array([d.lens_deg for d in draws])
    assert -3 <= lens.min() < -2.8
    assert 2.8 < lens.max() <= 3
    moved = np.array([d.camera for d in draws])
    assert np.abs(moved[:, :3]).max() <= ranges.camera.position
    assert np.degrees(np.abs(moved[:, 3:]).max()) <= ranges.camera.rotation_deg
    turns = np.array([light.turn for d in draws for light in d.lights])
    assert 18 < np.degrees(np.linalg.norm(turns, axis=1).max()) <= 20
    assert {d.table.texture for d in draws if d.table} == set(ranges.table.textures)
    assert all(0 <= part <= 1 for d in draws for look in d.looks.values() for part in look.rgb)
    delays = np.array([d.arm_dynamics[0].command_delay_ms for d in draws])
    assert 5 <= delays.min() < 5.5
    assert 29.5 < delays.max() <= 30
    errors = np.array([d.arm_dynamics[0].gravity for d in draws])
    assert errors.shape == (300, 6)
    assert 0.045 < np.abs(errors).max() <= 0.05
    assert np.abs(np.corrcoef(errors.T) - np.eye(6)).max() < 0.3


@pytest.mark.slow
def test_textures_come_up_as_often_as_their_weights_say(randomized: RecordConfig) -> None:
    for weights in ({"plain": 3.0, "noise": 1.0}, {"noise": 1.0, "plain": 3.0}):
        surface = SurfaceRanges(saturation=(0, 1), value=(0, 1), contrast=(0, 0.5), textures=weights)
        found = Counter(sampled(randomized, AttemptJob(0, k), table=surface).table.texture for k in range(400))  # type: ignore[union-attr]
        assert 260 < found["plain"] < 340


def test_streams_differ_whatever_splits_them() -> None:
    states = [
        random_generator(JOB, Stream.NOISE, *of).integers(2**60)
        for of in [(), (0,), (1,), (0, 0), (0, 1), (1, 0), (0, 0, 0)]
    ]
    assert len(set(states)) == len(states)


@pytest.mark.parametrize("not_drawn", ["", "arm_dynamics", "randomized"])
def test_the_ledger_keeps_draws_and_states_what_was_not_drawn(randomized: RecordConfig, not_drawn: str) -> None:
    without_arms = {"arm_dynamics": None} if not_drawn == "arm_dynamics" else {}
    drawn = RandomizationSample() if not_drawn == "randomized" else sampled(randomized, **without_arms)
    record = AttemptRecord(
        attempt=5, seed=3, episode=None, outcome=OutcomeRecord.from_outcome(Outcome(False)), layout={}, randomized=drawn
    )
    text = to_json(record)
    keys = {field.name for field in fields(RandomizationSample)}
    assert set(json.loads(text)["randomized"]) == keys - {"walls", "pushes"}  # written only where they vary
    assert bool(json.loads(text)["randomized"]["arm_dynamics"]) == (not not_drawn)
    assert from_json(AttemptRecord, text, "ledger").randomized == drawn
