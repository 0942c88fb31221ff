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
_ELEVATIONS, _AZIMUTHS = (25.0, 45.0, 65.0, 85.0), 12  # degrees above the horizontal; steps around the vertical
_REFINEMENTS = (10.0, 5.0)  # degrees, steps around the best direction
_TRIM = 0.9  # share of pixels that the fit keeps: highlights and wrong outlines are no shading
_SATURATED = 250  # of 255, above which a photo's colour is no measure of the light
_EDGE_PX = 2  # px, border of the arms that is left out
_MIN_PIXELS = 50  # of the arms, without which the light is unknown


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
    """Of one photo: its colours on arms and table, and those of ambient light and headlight, each (n, 3)."""

    photo: StationPhoto
    arms: NDArray[np.bool_]
    table: NDArray[np.bool_]
    ambient: Image
    headlight: Image


def fit_light(renderer: StationRenderer, photos: Sequence[StationPhoto], progress: Progress) -> LightFit | None:
    """Return the light whose images are most like the photos; None if too little of the arms is visible.

    The table is taken as evenly coloured. The renderer keeps a white table afterwards.
    """
    renderer.show_white_table()
    bases = [_basis(renderer, photo) for photo in photos]
    if sum(int(basis.arms.sum()) for basis in bases) < _MIN_PIXELS:
        return None
    turns = np.arange(_AZIMUTHS) * 360.0 / _AZIMUTHS
    tried = {place: _fit(renderer, bases, *place) for place in itertools.product(_ELEVATIONS, map(float, turns))}
    best = min(tried, key=lambda place: _error(tried[place]))
    for number, step in enumerate(_REFINEMENTS):
        progress(number + 1, len(_REFINEMENTS) + 1)
        for up, around in itertools.product((-step, 0.0, step), repeat=2):
            # The same step on the sphere needs a larger turn near the vertical.
            place = (min(best[0] + up, 89.0), best[1] + around / max(0.2, math.cos(math.radians(best[0]))))
            if place[0] > 5.0 and place not in tried:
                tried[place] = _fit(renderer, bases, *place)
        best = min(tried, key=lambda place: _error(tried[place]))
    progress(len(_REFINEMENTS) + 1, len(_REFINEMENTS) + 1)
    return tried[best]


def _error(fit: LightFit) -> float:
    return fit.arm_error + fit.table_error


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


def _fit(renderer: StationRenderer, bases: Sequence[_Basis], elevation: float, azimuth: float) -> LightFit:
    dark, direction = (0.0,) * 3, _direction(elevation, azimuth)
    renderer.set_light(Light(dark, (_BASIS,) * 3, direction, dark))
    arms: list[list[Array]] = []
    surfaces: list[list[Array]] = []
    for basis in bases:
        renderer.set_postures(basis.photo.postures)
        images = basis.photo.image, basis.ambient, renderer.render(), basis.headlight
        arms.append([np.asarray(image[basis.arms], np.float64) for image in images])
        surfaces.append([np.asarray(image[basis.table], np.float64) for image in images])
    seen, *parts = (np.concatenate(part) for part in zip(*arms, strict=True))
    columns = [part / _BASIS for part in parts]
    strengths = np.array([_fit_channel(seen[:, k], *(part[:, k] for part in columns)) for k in range(3)])
    made = columns[0] * strengths[:, 0] + columns[1] * strengths[:, 1] + columns[2] * HEADLIGHT
    arm_error = float(np.abs(seen - np.clip(made, 0, 255)).mean())
    light = Light(tuple(strengths[:, 0]), tuple(strengths[:, 1]), direction, (HEADLIGHT,) * 3)
    return LightFit(light, arm_error, _table_error(surfaces, strengths))


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


def _table_error(surfaces: Sequence[Sequence[Array]], strengths: Array) -> float:
    """Return the mean difference of the table's colours to those of an evenly coloured table, of 255."""
    seen, ambient, diffuse, fixed = (np.concatenate(parts) for parts in zip(*surfaces, strict=True))
    if not len(seen):
        return 0.0
    shade = (ambient * strengths[:, 0] + diffuse * strengths[:, 1] + fixed * HEADLIGHT) / _BASIS
    albedo = np.median(seen / np.maximum(shade, 1.0), axis=0)
    return float(np.abs(seen - albedo * shade).mean())
