"""The light of the renderings that an image of quality `photo` averages, without Filament."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from yamsim_cli.photo_rendering.filament import _FilamentScene
from yamsim_cli.photo_rendering.light_samples import LightSample, make_dark_samples, make_light_samples

CASTING = [0, 1, 2]  # lights of MODEL that cast shadows
MODEL = """
<mujoco>
  <visual><headlight ambient="0 0 0" diffuse="0 0 0"/></visual>
  <worldbody>
    <light type="directional" diffuse="0.4 0.4 0.4"/>
    <light type="directional" diffuse="0.2 0.2 0.2"/>
    <light type="directional" diffuse="0.1 0.1 0.1"/>
    <light type="directional" diffuse="0.3 0.3 0.3" castshadow="false"/>
    <light type="directional" diffuse="0.9 0.9 0.9" active="false"/>
  </worldbody>
</mujoco>
"""


class Light:
    """Stands in for a light of Filament."""

    def __init__(self) -> None:
        self.intensity, self.active = 0.0, True

    def set_intensity(self, intensity: float) -> None:
        self.intensity = intensity

    def set_active(self, active: bool) -> None:
        self.active = active

    def set_color(self, colour: list[float]) -> None: ...

    def set_pose(self, position: list[float], direction: list[float]) -> None: ...


def illuminations(samples: list[LightSample]) -> NDArray[np.float64]:
    """Return the light (samples, 2) with and without shadows of each rendering, at the same gain."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    scene = _FilamentScene.__new__(_FilamentScene)
    scene._model = model
    scene._caster, scene._sky_caster, scene._headlight, scene._sky = Light(), Light(), Light(), Light()
    scene._others = [Light() for _ in range(model.nlight)]
    sources = {sample.source for sample in samples}
    found = []
    for sample in samples:
        scene.illuminate(data, sample, sources, np.ones(3), np.array([0.0, 0.0, -1.0]))
        shadowless = sum(light.intensity for light in scene._others if light.active)
        found.append([scene._caster.intensity * scene._caster.active, shadowless])
        found[-1] = [light / sample.gain for light in found[-1]]
    return np.array(found)


@pytest.mark.parametrize("number", [1, 2, 3, 4, 6, 12])
def test_the_mean_has_all_lights_at_any_number_of_samples(number: int) -> None:
    whole = illuminations(make_light_samples(18, CASTING)).mean(axis=0)
    assert whole[0] / whole[1] == pytest.approx((0.4 + 0.2 + 0.1) / 0.3)
    for samples in (make_light_samples(number, CASTING), make_dark_samples(number, CASTING)):
        assert illuminations(samples).mean(axis=0).sum() == pytest.approx(whole.sum())


def test_a_light_that_no_sample_names_has_no_shadows() -> None:
    shadows, shadowless = illuminations(make_light_samples(2, CASTING)).mean(axis=0)
    assert shadows / shadowless == pytest.approx(0.4 / (0.2 + 0.1 + 0.3))
