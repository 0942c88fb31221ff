"""What a sensor does to an image: exposure, white balance, noise, and the camera's own JPEG compression."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from .config import CameraEffects

Image = NDArray[np.uint8]

_WHITE = 255.0  # largest value of an image
# Encoding of light as sRGB values. Source: IEC 61966-2-1.
_LINEAR_SLOPE, _LINEAR_END, _POWER, _OFFSET = 12.92, 0.0031308, 2.4, 0.055


def light_of_value(value: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the light (0 to 1) of sRGB values (0 to 1)."""
    curved = ((value + _OFFSET) / (1 + _OFFSET)) ** _POWER
    return np.where(value <= _LINEAR_END * _LINEAR_SLOPE, value / _LINEAR_SLOPE, curved)


def value_of_light(light: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sRGB values (0 to 1) of light (0 to 1)."""
    curved = (1 + _OFFSET) * np.maximum(light, _LINEAR_END) ** (1 / _POWER) - _OFFSET
    return np.where(light <= _LINEAR_END, light * _LINEAR_SLOPE, curved)


def tone_table(effects: CameraEffects) -> Image:
    """Return the value (256, 3) after exposure and white balance of each value before, for red, green and blue."""
    gains = 2.0**effects.exposure_ev * np.array(effects.white_balance)
    light = light_of_value(np.arange(256) / _WHITE)[:, None] * gains
    return np.rint(_WHITE * value_of_light(np.minimum(light, 1.0))).astype(np.uint8)


def noise_table(effects: CameraEffects) -> NDArray[np.float32]:
    """Return the standard deviation (256,) of the noise at each value, in values.

    A pixel of light L has L times `full_well_e` electrons, whose number varies with its square root; read noise is
    added (EMVA 1288, without dark current). The slope of sRGB converts electrons to values, so the result holds for
    noise that is small compared with the range of values.
    """
    assert effects.full_well_e is not None
    light = light_of_value(np.arange(256) / _WHITE)
    electrons = np.sqrt(light * effects.full_well_e + effects.read_noise_e**2)
    # Chords over one value up and down; the encoding is smooth at this scale.
    up, down = (value_of_light(np.clip(light + step, 0, 1)) for step in (1e-4, -1e-4))
    width = np.clip(light + 1e-4, 0, 1) - np.clip(light - 1e-4, 0, 1)
    slope = _WHITE * (up - down) / width
    return (slope * electrons / effects.full_well_e).astype(np.float32)


class Sensor:
    """Applies the effects of one camera's sensor to its images."""

    def __init__(self, effects: CameraEffects) -> None:
        self._quality = effects.jpeg_quality
        table = tone_table(effects)
        self._tones = None if np.array_equal(table, np.arange(256)[:, None].repeat(3, 1)) else table[None]
        self._noise = noise_table(effects) if effects.full_well_e is not None else None

    def apply(self, image: Image, generator: Callable[[], np.random.Generator]) -> None:
        """Change an RGB image (height, width, 3) in place. Equal generators give equal images."""
        if self._tones is not None:
            cv2.LUT(image, self._tones, image)
        if self._noise is not None:
            noise = generator().standard_normal(image.shape, np.float32)
            noise *= self._noise[image]
            noise += image
            np.rint(noise, noise)
            np.clip(noise, 0, _WHITE, noise)
            image[:] = noise.astype(np.uint8)
        if self._quality is not None:
            image[:] = compress(image, self._quality)


def compress(image: Image, quality: int) -> Image:
    """Return an RGB image after JPEG compression of a quality, 1 to 100."""
    done, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    assert done
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR_RGB), np.uint8)
