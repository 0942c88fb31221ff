from __future__ import annotations

import math

import numpy as np
import pytest

from yamsim_cli.photo_rendering.light_samples import (
    LIGHT_RADIUS,
    SKY,
    jittered_direction,
    make_dark_samples,
    make_light_samples,
    sky_direction,
)


@pytest.mark.parametrize(("number", "lights"), [(1, []), (2, [0]), (12, [0]), (12, [0, 1]), (13, [0, 1, 3])])
def test_the_mean_has_all_of_each_source(number: int, lights: list[int]) -> None:
    samples = make_light_samples(number, lights)
    assert samples == make_light_samples(number, lights)
    assert len(samples) == number
    for source in (*lights, SKY):
        assert sum(one.weight for one in samples if one.source == source) == pytest.approx(number)
    assert np.mean([one.shift for one in samples], axis=0) == pytest.approx([0, 0], abs=1e-12)


def test_lights_without_a_sample_cast_no_shadow_and_are_named_by_no_sample() -> None:
    assert {one.source for one in make_light_samples(4, [0, 1, 2])} == {SKY, 0, 1}


def test_samples_for_dark_tones_have_each_source_once() -> None:
    samples = make_dark_samples(12, [0, 2])
    assert [one.source for one in samples] == [SKY, 0, 2]
    assert {one.weight for one in samples} == {3}
    assert all(one.gain > 2 * other.gain for one in samples for other in make_light_samples(12, [0, 2]))


def test_directions_stay_within_the_light() -> None:
    direction = np.array([-0.35, 0.3, -1.0]) / np.linalg.norm([-0.35, 0.3, -1.0])
    turned = [
        math.acos(direction @ jittered_direction(direction, one.offset))
        for one in make_light_samples(12, [0])
        if one.source == 0
    ]
    assert max(turned) <= LIGHT_RADIUS
    assert len(set(np.round(turned, 9))) == len(turned)


def test_the_sky_shines_downwards_from_all_sides() -> None:
    directions = [sky_direction(one.offset) for one in make_light_samples(16, [])]
    assert all(np.linalg.norm(one) == pytest.approx(1) and one[2] < -0.45 for one in directions)
    assert np.abs(np.mean(directions, axis=0)[:2]).max() < 0.15
