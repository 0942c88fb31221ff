"""The light is found in photos with another tone curve than the renderer's."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.hidden_stations import hidden_station, take_photos
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rendering import RenderConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.match.light_fit import StationPhoto, _table_error, fit_light
from yamsim_cli.match.pinhole_view import PinholeView
from yamsim_cli.match.station_renderer import StationRenderer

_GAMMA = 2.2  # darkens all tones, and dark ones most, as a physically based renderer does
# Its arms shade only a small part of the table: a fit that compares exact shadows alone is 25 degrees off.
_STATION = 5


def test_a_shadow_that_the_table_lacks_is_an_error() -> None:
    ambient, light = np.full((100, 3), 60.0), np.full((100, 3), 120.0)
    shadowed = light.copy()
    shadowed[:20] = 0.0
    least = np.full(3, 0.2)
    even, with_shadow = ambient + light, ambient + shadowed
    assert _table_error([[even, ambient, light]], least) == pytest.approx(0.0, abs=1e-6)
    assert _table_error([[with_shadow, ambient, shadowed]], least) == pytest.approx(0.0, abs=1e-6)
    assert _table_error([[even, ambient, shadowed]], least) > 10
    assert _table_error([[with_shadow, ambient, light]], least) > 10
    # The depth of a shadow is free above the least one.
    assert _table_error([[ambient + 0.7 * shadowed, ambient, shadowed]], least) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.slow
@pytest.mark.render
def test_the_light_is_found_in_photos_with_another_tone_curve(locations: Locations) -> None:
    station = hidden_station(_STATION, locations, 2, (200, 150))
    view = PinholeView.of_camera(station.camera, station.T_cam_in_world)
    size = view.intrinsics.width, view.intrinsics.height
    photos = []
    for (image, _), posture in zip(take_photos(station, locations), station.postures, strict=True):
        toned = np.rint(255 * (view.undistort(image) / 255.0) ** _GAMMA).astype(np.uint8)
        photos.append(StationPhoto(toned, posture))
    scene = load_config(SceneConfig, "scenes", "tabletop", locations)
    quality = load_config(RenderConfig, "quality", "fast", locations)
    widened = scene.widened_for_arm_distance(station.rig.arm_span)
    with StationRenderer(station.rig, widened, quality, view.scene_camera, size, locations) as renderer:
        fit = fit_light(renderer, photos, lambda *_: None)
    assert fit is not None
    assert math.degrees(math.acos(min(1.0, np.dot(fit.light.direction, station.direction)))) < 10
