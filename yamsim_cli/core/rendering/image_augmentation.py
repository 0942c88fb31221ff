"""Image augmentation: brightness and contrast, Gaussian noise, salt and pepper."""

from __future__ import annotations

import cv2
import numpy as np

from ..attempt_data import AttemptJob
from ..config.randomization import PictureRanges
from ..config.variation import RandomizationSample
from ..images.image import Image
from ..scene.random_streams import Stream, random_generator

_CONTRAST_PIVOT = 127.5  # 0 to 255, grey level that a change of contrast leaves unchanged
_NOISE_MARGIN_DIVISOR = 4  # sampled noise exceeds an image by 1/4 of its values, so that each image uses another part


class ImageAugmenter:
    """Augments the images of one attempt. The random numbers of an image depend only on its job, frame and camera.

    Gaussian noise is sampled once per attempt, and each image uses a random part of it. Sampling new noise for each
    image would take a third of the rendering time.
    """

    def __init__(
        self, ranges: PictureRanges, variation: RandomizationSample, job: AttemptJob, size: tuple[int, int]
    ) -> None:
        self._ranges = ranges
        self._variation = variation
        self._job = job
        self._values = size[0] * size[1] * 3
        self._noise_parts: tuple[Image, Image] | None = None

    def apply(self, image: Image, frame: int, camera: int) -> None:
        """Augment an RGB image (height, width, 3) in place, seeded by the indices of its frame and camera."""
        self._apply_tone(image, random_generator(self._job, Stream.TONE, frame, camera))
        if self._variation.noise:
            self._apply_noise(image, random_generator(self._job, Stream.NOISE, frame, camera))
        if self._variation.salt_pepper:
            self._apply_salt_pepper(image, random_generator(self._job, Stream.SALT_PEPPER, frame, camera))

    def _apply_tone(self, image: Image, rng: np.random.Generator) -> None:
        brightness = 255.0 * float(rng.uniform(*self._ranges.brightness))
        contrast = float(rng.uniform(*self._ranges.contrast))
        if brightness == 0.0 and contrast == 1.0:
            return
        cv2.addWeighted(image, contrast, image, 0.0, _CONTRAST_PIVOT * (1.0 - contrast) + brightness, image)

    def _apply_noise(self, image: Image, rng: np.random.Generator) -> None:
        if self._noise_parts is None:
            sigma = np.float32(self._variation.noise)
            normal = random_generator(self._job, Stream.NOISE, 0).standard_normal(
                self._values + self._values // _NOISE_MARGIN_DIVISOR, np.float32
            )
            noise = np.clip(np.rint(normal * sigma), -127, 127).astype(np.int16)
            # Positive and negative parts: adding and subtracting uint8 arrays is six times as fast.
            self._noise_parts = np.maximum(noise, 0).astype(np.uint8), np.maximum(-noise, 0).astype(np.uint8)
        start = int(rng.integers(self._values // _NOISE_MARGIN_DIVISOR))
        raised, lowered = (part[start : start + self._values].reshape(image.shape) for part in self._noise_parts)
        cv2.add(image, raised, image)
        cv2.subtract(image, lowered, image)

    def _apply_salt_pepper(self, image: Image, rng: np.random.Generator) -> None:
        pixels = image.reshape(-1, 3)
        assert self._variation.salt_pepper is not None
        count = int(rng.binomial(len(pixels), self._variation.salt_pepper))
        pixels[rng.integers(len(pixels), size=count)] = 255 * rng.integers(2, size=(count, 1))
