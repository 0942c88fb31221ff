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
from yamsim_cli.match.light_fit import StationPhoto, fit_light
from yamsim_cli.match.pinhole_view import PinholeView
from yamsim_cli.match.station_renderer import StationRenderer

_GAMMA = 2.2  # darkens all tones, and dark ones most, as a physically based renderer does
# Its arms shade only a small part of the table: a fit that compares exact shadows alone is 25 degrees off.
_STATION = 5


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
