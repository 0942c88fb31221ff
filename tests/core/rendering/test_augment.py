from __future__ import annotations

import numpy as np
import pytest

from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.randomization import PictureRanges
from yamsim_cli.core.config.variation import RandomizationSample
from yamsim_cli.core.rendering.image_augmentation import ImageAugmenter

SIZE = (160, 120)
GREY = np.full((120, 160, 3), 128, np.uint8)


def augmented(ranges: PictureRanges, frame: int = 0, camera: int = 0, attempt: int = 0, **drawn: float) -> np.ndarray:
    image = GREY.copy()
    ImageAugmenter(ranges, RandomizationSample(**drawn), AttemptJob(0, attempt), SIZE).apply(image, frame, camera)
    return image


def test_without_any_range_a_picture_stays_as_it_is() -> None:
    np.testing.assert_array_equal(augmented(PictureRanges(), noise=0.0, salt_pepper=0.0), GREY)


def test_a_picture_follows_from_its_numbers_alone() -> None:
    """Earlier changes have no effect."""
    ranges = PictureRanges(brightness=(-0.1, 0.1), contrast=(0.8, 1.2), noise=(4, 4), salt_pepper=(0.01, 0.01))
    worker = ImageAugmenter(ranges, RandomizationSample(noise=4.0, salt_pepper=0.01), AttemptJob(0, 0), SIZE)
    for frame in (5, 3, 4):
        image = GREY.copy()
        worker.apply(image, frame, 1)
        np.testing.assert_array_equal(image, augmented(ranges, frame, 1, noise=4.0, salt_pepper=0.01))
    first = augmented(ranges, 0, 0, noise=4.0)
    for other in ({"frame": 1}, {"camera": 1}, {"attempt": 1}):
        assert (augmented(ranges, **other, noise=4.0) != first).mean() > 0.3  # type: ignore[arg-type]


def test_noise_is_as_strong_as_drawn() -> None:
    image = augmented(PictureRanges(), noise=4.0).astype(float) - 128
    assert image.std() == pytest.approx(4.0, rel=0.02)
    assert abs(image.mean()) < 0.05
    assert abs((image**3).mean()) / 64 < 0.1


def test_noise_at_the_ends_is_cut_and_does_not_wrap() -> None:
    for level in (0, 255):
        image = np.full((120, 160, 3), level, np.uint8)
        ImageAugmenter(PictureRanges(), RandomizationSample(noise=4.0), AttemptJob(0, 0), SIZE).apply(image, 0, 0)
        assert np.abs(image.astype(int) - level).max() < 30


def test_salt_and_pepper_are_as_many_as_drawn() -> None:
    image = augmented(PictureRanges(), salt_pepper=0.05)
    salt, pepper = ((image == level).all(axis=2).mean() for level in (255, 0))
    assert salt + pepper == pytest.approx(0.05, rel=0.1)
    assert 0.4 < salt / (salt + pepper) < 0.6
    assert set(np.unique(image)) == {0, 128, 255}


def test_brightness_and_contrast_are_about_the_middle() -> None:
    assert (augmented(PictureRanges(brightness=(0.1, 0.1))) == 154).all()
    assert (augmented(PictureRanges(contrast=(1.5, 1.5))) == 128).all()
    image = np.full((120, 160, 3), 28, np.uint8)
    ImageAugmenter(PictureRanges(contrast=(0.5, 0.5)), RandomizationSample(), AttemptJob(0, 0), SIZE).apply(image, 0, 0)
    assert (image == 78).all()


def test_parts_of_a_picture_draw_apart() -> None:
    """Without noise, salt and pepper affect the same pixels."""
    ranges = PictureRanges(brightness=(-0.05, 0.05))
    with_noise, without = (augmented(ranges, noise=noise, salt_pepper=0.02) for noise in (3.0, 0.0))
    np.testing.assert_array_equal((with_noise == 255).all(axis=2), (without == 255).all(axis=2))
