"""Images by Filament itself. Needs `mujoco-studio` and a Vulkan driver."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.attempts import start_of
from tests.cli.run_cli import yamsim
from tools.bench.photo import outline_distance
from yamsim_cli.camera_rendering import HIDDEN_GROUP
from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.reader import open_episode
from yamsim_cli.core.episode.attempt_payload import render_cameras
from yamsim_cli.core.episode.sampling import sample_attempt
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.images.image import Image
from yamsim_cli.core.rendering.renderer import SceneRenderer
from yamsim_cli.photo_rendering import filament_process
from yamsim_cli.photo_rendering.filament_context import require_filament

SIZE = (160, 120)
CAMERAS = ("scene_camera", "right_wrist_camera")

pytestmark = [pytest.mark.slow, pytest.mark.render]

OpenSimulator = Callable[..., Simulator]


@pytest.fixture(autouse=True)
def needs_filament() -> None:
    try:
        require_filament()
    except ResourceError as error:
        pytest.skip(str(error))


@pytest.fixture
def open_simulator(make_config: Callable[..., RecordConfig], locations: Locations) -> Iterator[OpenSimulator]:
    opened: list[Simulator] = []

    def open_one(quality: str = "photo", samples: int | None = None) -> Simulator:
        changes = {("render",): quality, ("image", "size_px"): list(SIZE), ("wrist",): True}
        if samples is not None:
            changes |= {("render", "photo_samples"): samples}
        config = make_config(changes)
        simulator = Simulator(Session(config, locations))
        simulator.state_replay.set_state(start_of(simulator))
        opened.append(simulator)
        return simulator

    yield open_one
    for simulator in opened:
        simulator.close()


def picture(simulator: Simulator, camera: str = "scene_camera") -> Image:
    return simulator.renderer.render(simulator.state_replay.data, camera).copy()


def test_equal_states_give_equal_images(open_simulator: OpenSimulator) -> None:
    first, second = open_simulator(), open_simulator()
    images = {camera: picture(first, camera) for camera in CAMERAS}
    # In another order, between images of another renderer.
    for camera in reversed(CAMERAS):
        assert (picture(second, camera) == images[camera]).all()
        assert (picture(first, camera) == images[camera]).all()


def test_a_plain_scene_is_as_bright_as_in_high(open_simulator: OpenSimulator) -> None:
    photo, high = open_simulator(), open_simulator("high")
    for camera in CAMERAS:
        assert np.median(picture(photo, camera)) == pytest.approx(np.median(picture(high, camera)), abs=10)


@pytest.mark.parametrize("camera", CAMERAS)
def test_outlines_agree_with_those_of_masks(open_simulator: OpenSimulator, camera: str) -> None:
    simulator = open_simulator()
    found = outline_distance(simulator, start_of(simulator), camera, SIZE)
    assert found.mean < 0.2
    assert found.worst < 0.5


def test_lights_and_materials_have_an_effect(open_simulator: OpenSimulator) -> None:
    simulator = open_simulator()
    model = simulator.scene.model
    plain = picture(simulator).astype(int)
    model.light_diffuse[:] *= 1.5
    brighter = picture(simulator).astype(int)
    assert np.median(brighter) > np.median(plain) + 5
    model.vis.headlight.ambient[:] = [0.5, 0.2, 0.2]
    redder = picture(simulator).mean(axis=(0, 1))
    assert redder[0] / redder[2] > 1.1 * brighter.mean(axis=(0, 1))[0] / brighter.mean(axis=(0, 1))[2]
    seen = simulator.renderer.render_geom_ids(simulator.state_replay.data, "scene_camera") == model.geom("table").id
    model.mat_rgba[model.material("table").id, :3] = [0.1, 0.6, 0.1]
    red, green, blue = picture(simulator)[seen].mean(axis=0)
    assert green > 2 * max(red, blue)


def test_a_glossy_metal_differs_from_a_dull_one(open_simulator: OpenSimulator) -> None:
    simulator = open_simulator()
    model = simulator.scene.model
    plain = picture(simulator).astype(int)
    model.mat_metallic[:], model.mat_roughness[:] = 1.0, 0.2
    assert np.abs(picture(simulator) - plain).mean() > 5


def test_shadows_are_soft(open_simulator: OpenSimulator) -> None:
    """Without the arm's and the objects' shadows, the table has one colour; with them, there are many between."""
    simulator = open_simulator()
    model, data = simulator.scene.model, simulator.state_replay.data
    table = simulator.renderer.render_geom_ids(data, "scene_camera") == model.geom("table").id
    shaded = picture(simulator)[table].mean(axis=1)
    levels = np.histogram(shaded, bins=np.arange(0, 256, 2))[0]
    assert shaded.max() - np.percentile(shaded, 1) > 15
    assert (levels >= 3).sum() >= 10


def test_hidden_parts_disappear(open_simulator: OpenSimulator) -> None:
    """As distractors and floors do that a variation leaves out."""
    simulator = open_simulator()
    model = simulator.scene.model
    picture(simulator)
    model.geom_group[model.geom_bodyid == 0] = HIDDEN_GROUP
    image = picture(simulator).astype(int)
    data = simulator.state_replay.data
    sky = simulator.renderer.render_geom_ids(data, "scene_camera") < 0
    assert sky.mean() > 0.5
    opengl = SceneRenderer.render(simulator.renderer, data, "scene_camera").astype(int)
    assert opengl[sky].max(axis=-1).mean() > 50
    assert (np.abs(image - opengl)[sky].max(axis=-1) <= 1).mean() > 0.95


def test_lights_that_no_rendering_shadows_shine_all_the_same(open_simulator: OpenSimulator) -> None:
    plain = np.median(picture(open_simulator()))
    few = open_simulator(samples=1)
    assert few.scene.model.light_castshadow.any()
    assert np.median(picture(few)) == pytest.approx(plain, abs=10)


def test_images_do_not_depend_on_earlier_variations(
    make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    """Lights, looks, textures, walls and distractors of an attempt leave nothing behind."""
    for ranges in ("default", "looks"):
        changes = {("render",): "photo", ("image", "size_px"): list(SIZE), ("randomization",): ranges}
        session = Session(make_config(changes), locations)
        images = []
        for seeds in ((1, 2, 3), (3,)):
            with Simulator(session) as simulator:
                attempts = [sample_attempt(simulator, AttemptJob(seed, 0)) for seed in seeds]
                images.append([render_cameras(simulator, one, one.start, ["scene_camera"]) for one in attempts][-1])
                if len(seeds) > 1:
                    first = render_cameras(simulator, attempts[0], attempts[0].start, ["scene_camera"])
        assert (images[0]["scene_camera"] == images[1]["scene_camera"]).all()
        assert np.abs(first["scene_camera"].astype(int) - images[0]["scene_camera"]).mean() > 5


def test_a_process_that_grew_is_replaced_and_draws_the_same(
    open_simulator: OpenSimulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulator = open_simulator()
    model = simulator.scene.model
    model.mat_rgba[model.material("table").id, :3] = [0.1, 0.6, 0.1]
    images = [picture(simulator, camera) for camera in CAMERAS]
    filament = simulator.renderer._filament
    assert filament._process is not None
    monkeypatch.setattr(filament_process, "MAX_BYTES", 0)
    first = filament._process
    assert (picture(simulator, CAMERAS[0]) == images[0]).all()
    assert (first.poll(), filament._process) == (0, None)
    assert (picture(simulator, CAMERAS[1]) == images[1]).all()


def test_a_process_that_dies_is_one_error_and_the_next_image_starts_another(open_simulator: OpenSimulator) -> None:
    simulator = open_simulator()
    image = picture(simulator)
    filament = simulator.renderer._filament
    filament._process.kill()
    with pytest.raises(ResourceError, match=r"ended with code -9 .*`yamsim doctor`"):
        picture(simulator)
    assert (picture(simulator) == image).all()
    process = filament._process
    simulator.close()
    assert process.poll() == 0


def test_a_recording_states_filament_and_is_verified(tmp_path: Path) -> None:
    record = ("record", "--n", "1", "--size", "32x24", "--quality", "photo", "--randomize", "--out", "data")
    assert yamsim(*record, cwd=tmp_path).code == 0
    assert "Filament of mujoco-studio" in open_episode(tmp_path / "data/ep_000000").record.renderer
    run = yamsim("verify", "data", "--images", "--json", cwd=tmp_path)
    assert run.code == 0, run.err
