"""Exposure, white balance, noise and compression against their formulas and cv2."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from yamsim_cli.camera_effects.config import CameraEffects
from yamsim_cli.camera_effects.sensor import Sensor, light_of_value, tone_table, value_of_light


def applied(effects: CameraEffects, image: np.ndarray, seed: int = 0) -> np.ndarray:
    """An image after the sensor."""
    changed = image.copy()
    Sensor(effects).apply(changed, lambda: np.random.default_rng(seed))
    return changed


def test_srgb_is_its_own_inverse() -> None:
    values = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(value_of_light(light_of_value(values)), values, atol=1e-6)
    assert light_of_value(np.array([0.5]))[0] == pytest.approx(0.214041, abs=1e-6)  # IEC 61966-2-1


def test_exposure_and_white_balance_multiply_the_light() -> None:
    table = tone_table(CameraEffects(exposure_ev=1.0, white_balance=(1.0, 0.5, 0.25)))
    light, after = light_of_value(np.arange(256) / 255), light_of_value(table / 255.0)
    for channel, gain in enumerate((2.0, 1.0, 0.5)):
        wanted = np.minimum(gain * light, 1.0)
        # Half a value of rounding, at the steepest slope of the encoding's inverse.
        assert np.abs(after[:, channel] - wanted).max() < 0.5 / 255 * 2.4
    np.testing.assert_array_equal(table[:, 1], np.arange(256))


def test_without_effects_the_image_stays() -> None:
    image = np.random.default_rng(1).integers(0, 256, (20, 30, 3), np.uint8)
    np.testing.assert_array_equal(applied(CameraEffects(), image), image)


@pytest.mark.parametrize("value", [40, 100, 180])
def test_noise_is_that_of_electrons(value: int) -> None:
    """The variance of the light is (electrons + read noise squared) / full well squared."""
    full, read = 8000.0, 20.0
    noisy = applied(CameraEffects(full_well_e=full, read_noise_e=read), np.full((300, 300, 3), value, np.uint8))
    light = float(light_of_value(np.array([value / 255]))[0])
    slope = 255 * float(np.diff(value_of_light(np.array([light, light + 1e-5])))[0]) / 1e-5
    wanted = slope * np.sqrt(light * full + read**2) / full
    # Rounding to whole values adds a variance of 1/12.
    assert np.std(noisy) == pytest.approx(np.hypot(wanted, np.sqrt(1 / 12)), rel=0.03)
    assert np.mean(noisy) == pytest.approx(value, abs=0.1)


def test_noise_depends_on_its_generator_alone() -> None:
    image, effects = np.full((40, 40, 3), 128, np.uint8), CameraEffects(full_well_e=2000)
    np.testing.assert_array_equal(applied(effects, image, 3), applied(effects, image, 3))
    one, other = (applied(effects, image, seed).astype(float) - 128 for seed in (3, 4))
    assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.06


def test_compression_is_that_of_cv2() -> None:
    image = cv2.GaussianBlur(np.random.default_rng(2).integers(0, 256, (64, 64, 3), np.uint8), (0, 0), 3)
    data = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 20])[1]
    wanted = cv2.cvtColor(cv2.imdecode(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)
    np.testing.assert_array_equal(applied(CameraEffects(jpeg_quality=20), image), wanted)
    assert not np.array_equal(wanted, image)
