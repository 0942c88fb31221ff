"""Procedural textures, kinds of lights, and the looks that are held out for tests of policies."""

from __future__ import annotations

import math
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.randomization import RandomizationConfig
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.errors import ConfigError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import rotation_from_vector
from yamsim_cli.core.scene.randomization_sampling import sample_randomization
from yamsim_cli.core.workers.stop_request import StopRequest
from yamsim_cli.procedural.light_kinds import (
    HELD_OUT_LIGHTS,
    KINDS,
    LightKind,
    chromaticity_of_temperature,
    colour_of_temperature,
    rotation_between,
    sample_light,
)
from yamsim_cli.procedural.textures import HELD_OUT_TEXTURES, Texture, texture_pattern
from yamsim_cli.recording.collect import RecordCallbacks
from yamsim_cli.recording.executor_factories import process_executor
from yamsim_cli.recording.recorder import record
from yamsim_cli.recording.recording_output import RecordingOutput

TEXTURES = [name for name in get_args(Texture) if name != "plain"]
DOWN = (-0.35, 0.30, -1.0)


@pytest.mark.parametrize("texture", TEXTURES)
def test_a_pattern_mixes_two_colours_and_depends_only_on_its_seed(texture: str) -> None:
    made = texture_pattern(texture, 3, 5, 128)
    assert made.shape == (128, 128)
    assert 0 <= made.min() < made.max() <= 1
    assert made.std() > 0.05
    np.testing.assert_array_equal(made, texture_pattern(texture, 3, 5, 128))
    if texture not in ("checker",):
        assert (made != texture_pattern(texture, 3, 6, 128)).any()


@pytest.mark.parametrize("texture", sorted(set(TEXTURES) - {"gradient"}))
def test_a_pattern_can_be_repeated_without_a_seam(texture: str) -> None:
    """Across the seam, neighbouring pixels differ about as much as they do at joints inside."""
    made = texture_pattern(texture, 3, 5, 192)
    for axis in (0, 1):
        inside = np.abs(np.diff(made, axis=axis)).mean(axis=1 - axis)
        seam = np.abs(np.take(made, 0, axis) - np.take(made, -1, axis)).mean()
        assert seam <= 1.5 * inside.max() + 1e-9


def test_textures_are_distinct() -> None:
    made = [texture_pattern(name, 3, 5, 64) for name in TEXTURES]
    assert len({pattern.tobytes() for pattern in made}) == len(TEXTURES)


def test_colours_of_temperatures_are_those_of_black_bodies() -> None:
    # Source: CIE 15, illuminant A (2856 K), and the black body of 6504 K.
    assert chromaticity_of_temperature(2856) == pytest.approx((0.4476, 0.4074), abs=2e-3)
    assert chromaticity_of_temperature(6504) == pytest.approx((0.3135, 0.3237), abs=2e-3)
    np.testing.assert_allclose(colour_of_temperature(4500), 1)
    warm, cool = colour_of_temperature(2700), colour_of_temperature(9000)
    assert warm[0] > warm[1] > warm[2]
    assert cool[0] < cool[1] < cool[2]


@pytest.mark.parametrize("kind", get_args(LightKind))
def test_a_kind_of_light_shines_from_its_elevations(kind: str) -> None:
    rng = np.random.default_rng(4)
    unit = np.array(DOWN) / np.linalg.norm(DOWN)
    low, high = KINDS[kind].elevation_deg
    azimuths = []
    for _ in range(50):
        turn, colour = sample_light(kind, DOWN, rng)
        x, y, z = rotation_from_vector(turn) @ unit
        assert low - 1e-6 <= math.degrees(math.asin(-z)) <= high + 1e-6
        assert colour @ (0.2126, 0.7152, 0.0722) == pytest.approx(1)
        azimuths.append(math.atan2(y, x))
    assert max(azimuths) - min(azimuths) > math.pi


def test_the_rotation_between_directions_turns_one_to_the_other() -> None:
    np.testing.assert_allclose(
        rotation_from_vector(rotation_between((0, 0, -3), (1, 0, 0))) @ (0, 0, -1), (1, 0, 0), atol=1e-12
    )
    np.testing.assert_array_equal(rotation_between((1, 2, 3), (1, 2, 3)), 0)


def names_used(config: RandomizationConfig) -> set[str]:
    surfaces = [part.textures for part in (config.table, config.floor, config.walls) if part]
    return set().union(*surfaces, (config.lights and config.lights.kinds) or ())


def shipped() -> dict[str, RandomizationConfig]:
    where = Locations.from_environment({})
    files = (Path(__file__).parents[2] / "configs" / "randomization").glob("*.yaml")
    return {path.stem: load_config(RandomizationConfig, "randomization", path.stem, where) for path in files}


def test_held_out_looks_share_no_texture_and_no_kind_of_light_with_others() -> None:
    configs = shipped()
    assert [name for name, config in configs.items() if config.held_out] == ["heldout"]
    held_out = names_used(configs.pop("heldout"))
    assert held_out == HELD_OUT_TEXTURES | HELD_OUT_LIGHTS
    for config in configs.values():
        assert not names_used(config) & held_out


def test_other_looks_cannot_use_what_is_held_out(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("walls: {saturation: [0, 1], value: [0, 1], contrast: [0, 1], textures: {plain: 1, bricks: 1}}\n")
    with pytest.raises(ConfigError, match="bricks: only for looks with held_out: true"):
        load_config(RandomizationConfig, "randomization", str(file), Locations.from_environment({}))


def test_nothing_is_recorded_with_held_out_looks(tmp_path: Path) -> None:
    where = Locations.from_environment({})
    config = load_config(RecordConfig, "record", "default", where, {("randomization",): ("test", "heldout")})
    output = RecordingOutput(tmp_path / "out", ExistingDatasetMode.NEW)
    callbacks = RecordCallbacks(lambda *_: None, lambda _: None)
    with pytest.raises(UsageError, match="randomization 'heldout' is held out for tests of policies"):
        record(
            Session(config, where),
            output,
            process_executor,
            callbacks,
            StopRequest(),
        )
    assert not (tmp_path / "out").exists()


def test_kinds_of_lights_change_no_other_sample() -> None:
    where = Locations.from_environment({})
    config = load_config(RecordConfig, "record", "default", where, {("randomization",): ("test", "looks")})
    ranges, lights = config.randomization, config.scene.lights
    assert ranges.lights is not None
    plain = ranges.model_copy(update={"lights": ranges.lights.model_copy(update={"kinds": None}), "walls": None})
    job = AttemptJob(3, 7)
    with_kinds = sample_randomization(ranges, job, lights, config.task.objects, (6,))
    without = sample_randomization(plain, job, lights, config.task.objects, (6,))
    assert with_kinds.table == without.table
    assert with_kinds.floor == without.floor
    assert with_kinds.walls is not None
    assert without.walls is None
    assert with_kinds.lights[0].turn != without.lights[0].turn
