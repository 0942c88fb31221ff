"""Which lights illuminate each of the renderings that an image of quality `photo` averages.

Filament casts shadows from one directional light. So each rendering has one light with shadows: in turn a light of the
scene, and one direction of the sky. The average has the shadows of all of them. The directions vary within a light's
radius, and within the sky, which makes the edges of shadows soft. The camera moves by parts of a pixel, which makes
other edges smooth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SKY = -1  # number of the source of `LightSample` that stands for the sky
LIGHT_RADIUS = math.radians(2.0)  # rad, half the angle under which a light is seen: a ceiling panel 10 cm wide at 1.5 m
# Gains of the first and the last rendering, and of those for dark tones. Gains that differ let the average resolve more
# than the 8 bits of linear light of each. The first two leave room for surfaces that are brighter than white.
_GAINS, _DARK_GAIN = (0.8, 0.4), 6.0
# Cosine of the largest angle to the vertical of the sky's directions. Flatter light would have to be brighter to
# illuminate a table as much, and its reflections would be glaring.
_MIN_SKY_COSINE = 0.5
_GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))  # rad, spreads points evenly over a disc
_R2 = (0.7548776662466927, 0.5698402909980532)  # steps of a sequence that spreads points evenly over a square


@dataclass(frozen=True)
class LightSample:
    """One of the renderings that an image averages.

    Attributes:
        source: number of the light that casts shadows, or `SKY`.
        weight: factor on the intensity of the source, because it is missing in the other renderings.
        offset: for a light, its displacement across its direction, as the tangent of an angle (2,). For the sky, the
            azimuth in rad, and the cosine of the angle to the vertical.
        gain: factor on all light.
        shift: displacement of the camera (right, up), px.
    """

    source: int
    weight: float
    offset: tuple[float, float]
    gain: float
    shift: tuple[float, float]


def make_light_samples(number: int, lights: Sequence[int]) -> list[LightSample]:
    """Return `number` samples of the `lights` that cast shadows and of the sky, which gets every second one.

    No sample names the lights beyond half the number, which are to shine without shadows in each rendering. Equal
    arguments give equal samples.
    """
    sources = _sources(number, lights)
    shifts = np.array([[((k + 0.5) * step) % 1.0 for step in _R2] for k in range(number)])
    shifts -= shifts.mean(axis=0)
    gains = np.geomspace(*_GAINS, number)
    return [
        LightSample(
            source,
            number / sources.count(source),
            _offset(source, sources[:k].count(source), sources.count(source)),
            float(gains[k]),
            (float(shifts[k, 0]), float(shifts[k, 1])),
        )
        for k, source in enumerate(sources)
    ]


def make_dark_samples(number: int, lights: Sequence[int]) -> list[LightSample]:
    """Return samples for dark tones, one for each source of `make_light_samples`. Light tones saturate in them."""
    sources = list(dict.fromkeys(_sources(number, lights)))
    return [LightSample(source, len(sources), _offset(source, 0, 1), _DARK_GAIN, (0.0, 0.0)) for source in sources]


def _sources(number: int, lights: Sequence[int]) -> list[int]:
    return [SKY if k % 2 == 0 or not lights else lights[k // 2 % len(lights)] for k in range(number)]


def _offset(source: int, index: int, count: int) -> tuple[float, float]:
    """Return `LightSample.offset` of one of `count` samples of a source. Those of the sky are dense at the zenith."""
    share, angle = (index + 0.5) / count, index * _GOLDEN_ANGLE
    if source == SKY:
        return angle, math.sqrt(1 - share * (1 - _MIN_SKY_COSINE**2))
    return _on_circle(math.tan(LIGHT_RADIUS) * math.sqrt(share) if count > 1 else 0.0, angle)


def _on_circle(radius: float, angle: float) -> tuple[float, float]:
    return radius * math.cos(angle), radius * math.sin(angle)


def jittered_direction(direction: NDArray[np.float64], offset: tuple[float, float]) -> NDArray[np.float64]:
    """Return the unit vector `direction` (3,) displaced by an offset of a light's `LightSample`."""
    axis = np.eye(3)[int(np.argmin(np.abs(direction)))]
    across = np.cross(direction, axis)
    across /= np.linalg.norm(across)
    moved = direction + offset[0] * across + offset[1] * np.cross(direction, across)
    return np.asarray(moved / np.linalg.norm(moved), np.float64)


def sky_direction(offset: tuple[float, float]) -> NDArray[np.float64]:
    """Return the unit vector (3,), in `world`, along which light from a direction of the sky travels."""
    azimuth, cosine = offset
    x, y = _on_circle(math.sqrt(1 - cosine**2), azimuth)
    return np.array([-x, -y, -cosine])
