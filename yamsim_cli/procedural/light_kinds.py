"""Kinds of lights: an overhead panel, a window and a lamp. They differ in direction and colour temperature.

All are directional lights, as are all lights of scenes: their light does not weaken with distance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

LightKind = Literal["panel", "window", "lamp"]

# Kinds that only randomizations with `held_out` may use, so that no recording shows them.
HELD_OUT_LIGHTS = frozenset({"lamp"})

_WHITE_K = 4500.0  # K, for which the camera's white balance is set: between lamps and daylight

# CIE 1931 XYZ -> linear sRGB. Source: IEC 61966-2-1.
_RGB_FROM_XYZ = np.array(
    [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]],
)


@dataclass(frozen=True)
class LightRangesOfKind:
    """Ranges of a kind: elevation above the horizontal, degrees, and colour temperature, K."""

    elevation_deg: tuple[float, float]
    temperature_k: tuple[float, float]


# Colour temperatures: of white LED panels, of daylight from clouds and clear sky, and of warm white lamps.
KINDS: dict[str, LightRangesOfKind] = {
    "panel": LightRangesOfKind((65.0, 90.0), (3500.0, 5000.0)),
    "window": LightRangesOfKind((15.0, 40.0), (5500.0, 9000.0)),
    "lamp": LightRangesOfKind((35.0, 65.0), (2700.0, 3200.0)),
}


def sample_light(
    kind: str, direction: Sequence[float], rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Sample a light of a kind, with an arbitrary azimuth.

    Args:
        direction: (3,) in which the light shines now, in `world`, not upwards.

    Returns:
        The rotation vector (3,) that turns `direction` to the sampled one, rad.
        The factors (3,) of its colour on linear red, green and blue, with luminance 1.
    """
    ranges = KINDS[kind]
    azimuth = rng.uniform(-math.pi, math.pi)
    elevation = math.radians(rng.uniform(*ranges.elevation_deg))
    across = math.cos(elevation)
    sampled = np.array([across * math.cos(azimuth), across * math.sin(azimuth), -math.sin(elevation)])
    return rotation_between(direction, sampled), colour_of_temperature(rng.uniform(*ranges.temperature_k))


def rotation_between(start: ArrayLike, end: ArrayLike) -> NDArray[np.float64]:
    """Return the shortest rotation vector (3,), rad, that turns direction `start` to `end`, which is not its opposite.

    Both have three components and any length above 0.
    """
    a, b = (np.asarray(v, np.float64) / np.linalg.norm(v) for v in (start, end))
    axis = np.cross(a, b)
    sine = float(np.linalg.norm(axis))
    return np.asarray(axis * (math.atan2(sine, float(a @ b)) / sine)) if sine > 0 else np.zeros(3)


def chromaticity_of_temperature(temperature: float) -> tuple[float, float]:
    """Return CIE 1931 x and y of a black body of 1667 to 25000 K.

    Source: Kim et al., US patent 7024034 B2, cubic approximation of the Planckian locus.
    """
    t = 1000 / temperature
    if temperature < 4000:
        x = -0.2661239 * t**3 - 0.2343589 * t**2 + 0.8776956 * t + 0.179910
    else:
        x = -3.0258469 * t**3 + 2.1070379 * t**2 + 0.2226347 * t + 0.240390
    if temperature < 2222:
        y = -1.1063814 * x**3 - 1.34811020 * x**2 + 2.18555832 * x - 0.20219683
    elif temperature < 4000:
        y = -0.9549476 * x**3 - 1.37418593 * x**2 + 2.09137015 * x - 0.16748867
    else:
        y = 3.0817580 * x**3 - 5.87338670 * x**2 + 3.75112997 * x - 0.37001483
    return x, y


def colour_of_temperature(temperature: float) -> NDArray[np.float64]:
    """Return the factors (3,) of a light on linear red, green and blue, for a camera balanced for 4500 K."""

    def rgb_of(kelvin: float) -> NDArray[np.float64]:
        x, y = chromaticity_of_temperature(kelvin)
        return np.asarray(_RGB_FROM_XYZ @ (x / y, 1.0, (1 - x - y) / y))

    rgb = rgb_of(temperature) / rgb_of(_WHITE_K)
    luminance = float(np.array([0.2126, 0.7152, 0.0722]) @ rgb)
    return rgb / luminance
