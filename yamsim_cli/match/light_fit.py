"""Estimate the light of a station from the shading of its arms, and from their shadows on the table.

In MuJoCo's renderer, a pixel is linear in the light: albedo * (ambient + headlight + diffuse * shading). Images with
one of these lights alone are therefore a basis, in which the photo's colours are fitted for each direction.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.attempt_data import ArmPosture
from ..core.geometry.se3 import Array
from ..core.images.image import Image
from ..core.progress import Progress
from .station_renderer import Light, StationRenderer

HEADLIGHT = 0.15  # diffuse of the light at the camera in all scenes, see `core.scene.environment`
_BASIS = 0.5  # of each light in its basis image: white stays below 255
_GRID = {20.0: 16, 40.0: 14, 60.0: 9, 80.0: 4}  # degrees above the horizontal -> steps around the vertical, some 20 deg
# Degrees between a direction and its eight neighbours -> from how many of the best directions.
_REFINEMENTS = {11.0: 4, 6.0: 3, 3.0: 1}
# Sigma of a blur, as a share of the width, with which the table's shadows are compared before the last refinement: the
# thin shadow of an arm does not overlap with the shadow of a light that is 10 degrees away.
_BLUR = 0.03
_LOWEST, _HIGHEST = 5.0, 89.0  # degrees above the horizontal, between which a light is
_TRIM = 0.9  # share of pixels that the fit keeps: highlights and wrong outlines are no shading
_SATURATED = 250  # of 255, above which a photo's colour is no measure of the light
_EDGE_PX = 2  # px, border of the arms that is left out
# Least ratio of directional to ambient light on the table, as a share of that ratio on the arms. Without this limit, a
# light that puts the arms' shadows onto an unshaded part of the table has no error, because the fit then makes them
# invisible. Tone curves make shadows lighter: shares of 0.15 to 0.3 improved one of 20 stations and made no other worse
# by more than 3 degrees, and 0.6 put the light of another one off by 33 instead of 1 degrees.
_MIN_SHADOW_DEPTH = 0.2
_MAX_RATIO = 10.0  # of directional to ambient light on the arms that is believed: the fit may find no ambient light
_MIN_PIXELS = 50  # of the arms, without which the light is unknown

_Place = tuple[float, float]  # elevation above the horizontal, and azimuth, of a light, degrees


@dataclass(frozen=True)
class StationPhoto:
    """A photo (height, width, 3) without distortion, in the size of the renderer, and the arms' postures."""

    image: Image
    postures: Sequence[ArmPosture]


@dataclass(frozen=True)
class LightFit:
    """A fitted light, and the mean difference of photo and fit, of 255: on the arms and on the table."""

    light: Light
    arm_error: float
    table_error: float


@dataclass(frozen=True)
class _Basis:
    """Of one photo: its colours on arms and table, and the colours of ambient light and headlight, each (n, 3)."""

    photo: StationPhoto
    arms: NDArray[np.bool_]
    table: NDArray[np.bool_]
    ambient: Image
    headlight: Image


def fit_light(renderer: StationRenderer, photos: Sequence[StationPhoto], progress: Progress) -> LightFit | None:
    """Return the light whose images are most like the photos; None if too little of the arms is visible.

    The table is taken as evenly coloured. Its brightness in the light and in the arms' shadows is free: cameras have
    tone curves, and the renderer has none. The renderer keeps a white table afterwards.
    """
    renderer.show_white_table()
    bases = [_basis(renderer, photo) for photo in photos]
    if sum(int(basis.arms.sum()) for basis in bases) < _MIN_PIXELS:
        return None
    tried: dict[_Place, tuple[LightFit, float]] = {}

    def best(count: int, blurred: bool) -> list[_Place]:
        def error(place: _Place) -> float:
            fit, blurred_error = tried[place]
            return fit.arm_error + (blurred_error if blurred else fit.table_error)

        return sorted(tried, key=error)[:count]

    for up, count in _GRID.items():
        for k in range(count):
            tried[up, 360.0 * k / count] = _fit(renderer, bases, up, 360.0 * k / count)
    for number, (step, starts) in enumerate(_REFINEMENTS.items()):
        is_last = number == len(_REFINEMENTS) - 1
        progress(number + 1, len(_REFINEMENTS) + 1)
        for place in (near for start in best(starts, blurred=not is_last) for near in _neighbours(start, step)):
            if place not in tried:
                tried[place] = _fit(renderer, bases, *place)
    progress(len(_REFINEMENTS) + 1, len(_REFINEMENTS) + 1)
    return tried[best(1, False)[0]][0]


def _neighbours(place: _Place, step: float) -> list[_Place]:
    """Return the directions around one, at distances of `step`, degrees, and its diagonal."""
    found = []
    for up, around in itertools.product((-step, 0.0, step), repeat=2):
        # The same step on the sphere needs a larger turn near the vertical.
        turn = around / max(0.2, math.cos(math.radians(place[0])))
        # Steps beyond the vertical end at `_HIGHEST`, so that directions near it are tried.
        if _LOWEST < place[0] + up < 90.0 + step:
            found.append((min(place[0] + up, _HIGHEST), (place[1] + turn) % 360.0))
    return found


def _direction(elevation: float, azimuth: float) -> tuple[float, float, float]:
    up, around = math.radians(elevation), math.radians(azimuth)
    return -math.cos(up) * math.cos(around), -math.cos(up) * math.sin(around), -math.sin(up)


def _basis(renderer: StationRenderer, photo: StationPhoto) -> _Basis:
    renderer.set_postures(photo.postures)
    arms, table = renderer.masks()
    core = cv2.erode(arms.astype(np.uint8), np.ones((2 * _EDGE_PX + 1,) * 2, np.uint8)) > 0
    near = cv2.dilate(arms.astype(np.uint8), np.ones((2 * _EDGE_PX + 1,) * 2, np.uint8)) > 0
    dark, down = (0.0,) * 3, (0.0, 0.0, -1.0)
    images = []
    for ambient, headlight in ((_BASIS, 0.0), (0.0, _BASIS)):
        renderer.set_light(Light((ambient,) * 3, dark, down, (headlight,) * 3))
        images.append(renderer.render())
    return _Basis(photo, core, table & ~near, *images)


def _fit(
    renderer: StationRenderer, bases: Sequence[_Basis], elevation: float, azimuth: float
) -> tuple[LightFit, float]:
    """Return the best light of a direction, and its error on the table, of 255, with photo and rendering blurred."""
    dark, direction = (0.0,) * 3, _direction(elevation, azimuth)
    renderer.set_light(Light(dark, (_BASIS,) * 3, direction, dark))
    arms: list[list[Array]] = []
    surfaces: list[list[Array]] = []
    blurred: list[list[Array]] = []
    for basis in bases:
        renderer.set_postures(basis.photo.postures)
        images = basis.photo.image, basis.ambient, renderer.render(), basis.headlight
        arms.append([np.asarray(image[basis.arms], np.float64) for image in images])
        surfaces.append([np.asarray(image[basis.table], np.float64) for image in images[:3]])
        blurred.append([_blurred(image, basis.table) for image in images[:3]])
    seen, *parts = (np.concatenate(part) for part in zip(*arms, strict=True))
    columns = [part / _BASIS for part in parts]
    strengths = np.array([_fit_channel(seen[:, k], *(part[:, k] for part in columns)) for k in range(3)])
    made = columns[0] * strengths[:, 0] + columns[1] * strengths[:, 1] + columns[2] * HEADLIGHT
    arm_error = float(np.abs(seen - np.clip(made, 0, 255)).mean())
    light = Light(tuple(strengths[:, 0]), tuple(strengths[:, 1]), direction, (HEADLIGHT,) * 3)
    ratio = strengths[:, 1] / np.maximum(strengths[:, 0], 1e-9)
    least = _MIN_SHADOW_DEPTH * np.minimum(ratio, _MAX_RATIO)
    return LightFit(light, arm_error, _table_error(surfaces, least)), _table_error(blurred, least)


def _blurred(image: Image, region: NDArray[np.bool_]) -> Array:
    """Return the colours (n, 3) of a region after a blur that mixes them with each other alone."""
    sigma, inside = _BLUR * image.shape[1], region.astype(np.float32)
    mixed = cv2.GaussianBlur(image * inside[..., None], (0, 0), sigma)
    return np.asarray(mixed[region] / cv2.GaussianBlur(inside, (0, 0), sigma)[region, None], np.float64)


def _fit_channel(seen: Array, ambient: Array, diffuse: Array, headlight: Array) -> tuple[float, float]:
    """Return strengths of ambient and directional light, 0 or more, that fit one colour (n,) best."""
    wanted = seen - HEADLIGHT * headlight
    columns = np.column_stack([ambient, diffuse])
    keep = np.asarray(seen < _SATURATED)
    strengths = np.zeros(2)
    for _ in range(2):
        A, b = columns[keep], wanted[keep]
        strengths = np.asarray(np.linalg.lstsq(A, b, rcond=None)[0], np.float64)
        for k in (0, 1):
            if strengths[k] < 0:  # the other light alone
                alone = A[:, 1 - k]
                strengths[k] = 0.0
                strengths[1 - k] = max(0.0, float(alone @ b) / max(1e-9, float(alone @ alone)))
        rest = np.abs(wanted - columns @ strengths)
        keep = rest <= np.quantile(rest, _TRIM)
    return float(strengths[0]), float(strengths[1])


def _table_error(surfaces: Sequence[Sequence[Array]], least: Array) -> float:
    """Return the mean difference between the table's colours and an evenly coloured table, of 255.

    Its brightness in ambient and in directional light is fitted. The depth of shadows is free, but directional over
    ambient light is at least `least` (3,), one for each colour.
    """
    seen, ambient, diffuse = (np.concatenate(parts) for parts in zip(*surfaces, strict=True))
    if not len(seen):
        return 0.0
    none = np.zeros(len(seen))
    made = np.empty_like(seen)
    for k in range(3):
        dim, lit = _fit_channel(seen[:, k], ambient[:, k], diffuse[:, k], none)
        if lit < least[k] * dim:
            dim = _fit_channel(seen[:, k], ambient[:, k] + least[k] * diffuse[:, k], none, none)[0]
            lit = least[k] * dim
        made[:, k] = ambient[:, k] * dim + diffuse[:, k] * lit
    return float(np.abs(seen - made).mean())
