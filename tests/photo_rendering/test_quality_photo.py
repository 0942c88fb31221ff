"""Quality `photo` without Filament: refusals, the config, and which renderer makes which image."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from tests.attempts import start_of
from tests.cli.run_cli import yamsim
from yamsim_cli import camera_rendering, doctor
from yamsim_cli.camera_rendering import QualityRenderer
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.rendering import RenderConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.images.image import Image
from yamsim_cli.core.rendering.renderer import SceneRenderer
from yamsim_cli.photo_rendering import filament_context
from yamsim_cli.photo_rendering.filament_context import require_filament

SIZE = (64, 48)
COLOUR = (10, 200, 30)


class PlainFilament:
    """Stands in for Filament: images of one colour, and the background in their upper half."""

    description = "Filament of nowhere"

    def __init__(self, model: mujoco.MjModel, size: tuple[int, int], samples: int) -> None:
        self.size, self.samples, self.reloads, self.closed = size, samples, 0, False

    def render(self, data: mujoco.MjData, camera: str, background: Callable[[], Image]) -> Image:
        image = np.full((self.size[1], self.size[0], 3), COLOUR, np.uint8)
        half = self.size[1] // 2
        image[:half] = background()[:half]
        return image

    def reload_textures(self) -> None:
        self.reloads += 1

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def simulator(
    make_config: Callable[..., RecordConfig], locations: Locations, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Simulator]:
    monkeypatch.setattr(camera_rendering, "FilamentProcess", PlainFilament)
    config = make_config({("render", "photo_samples"): 5, ("image", "size_px"): list(SIZE), ("wrist",): True})
    with Simulator(Session(config, locations)) as simulator:
        simulator.state_replay.set_state(start_of(simulator))
        yield simulator


@pytest.fixture
def fresh_filament() -> Iterator[None]:
    """Forget whether Filament works, before and after a test."""
    require_filament.cache_clear()
    yield
    require_filament.cache_clear()


def test_other_qualities_are_recorded_as_before(locations: Locations) -> None:
    for name in ("fast", "balanced", "high"):
        assert "photo_samples" not in load_config(RenderConfig, "quality", name, locations).model_dump(mode="json")
    assert load_config(RenderConfig, "quality", "photo", locations).model_dump()["photo_samples"] > 0


@pytest.mark.render
def test_colours_come_from_filament_and_the_rest_from_opengl(simulator: Simulator) -> None:
    renderer, data = simulator.renderer, simulator.state_replay.data
    image = renderer.render(data, "scene_camera")
    assert (image[SIZE[1] // 2 :] == COLOUR).all()
    assert renderer.description.endswith("; Filament of nowhere")
    with SceneRenderer(simulator.scene.model, SIZE) as opengl:
        assert (renderer.render_depth(data, "scene_camera") == opengl.render_depth(data, "scene_camera")).all()
        assert (renderer.render_geom_ids(data, "scene_camera") == opengl.render_geom_ids(data, "scene_camera")).all()


@pytest.mark.render
def test_the_background_is_the_sky_and_leaves_opengl_as_it_was(simulator: Simulator) -> None:
    data, camera = simulator.state_replay.data, "right_wrist_camera"
    sky = simulator.renderer.render(data, camera)[: SIZE[1] // 2]
    with SceneRenderer(simulator.scene.model, SIZE) as opengl:
        ids = opengl.render_geom_ids(data, camera)[: SIZE[1] // 2]
        whole = opengl.render(data, camera)[: SIZE[1] // 2]
    # Blue everywhere, also where OpenGL shows an arm.
    assert (sky[..., 2] > sky[..., 0]).all()
    assert (sky[ids < 0] == whole[ids < 0]).all()
    assert SceneRenderer.render(simulator.renderer, data, camera).std() > sky.std()


@pytest.mark.render
def test_textures_and_the_end_reach_filament(simulator: Simulator) -> None:
    renderer = simulator.renderer
    assert isinstance(renderer, QualityRenderer)
    filament = renderer._filament
    assert isinstance(filament, PlainFilament)
    assert (filament.size, filament.samples) == (SIZE, 5)
    renderer.upload_texture(0)
    assert filament.reloads == 1
    simulator.close()
    assert filament.closed


@pytest.mark.render
def test_a_lens_distorts_images_of_filament(
    make_config: Callable[..., RecordConfig], locations: Locations, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(camera_rendering, "FilamentProcess", PlainFilament)
    effects = [{"camera": "scene_camera", "effects": {"letterbox": 1.0, "distortion": [-0.2, 0, 0, 0]}}]
    changes = {
        ("render", "photo_samples"): 1,
        ("image", "size_px"): list(SIZE),
        ("camera_effects",): effects,
    }
    with Simulator(Session(make_config(changes), locations)) as simulator:
        simulator.state_replay.set_state(start_of(simulator))
        image = simulator.renderer.render(simulator.state_replay.data, "scene_camera")
    assert image.shape == (SIZE[1], SIZE[0], 3)
    assert (image[:, :8] == 0).all()  # the bar
    assert (image[-1, SIZE[0] // 2] == COLOUR).all()


def test_a_missing_package_is_named_by_its_extra(monkeypatch: pytest.MonkeyPatch, fresh_filament: None) -> None:
    monkeypatch.setitem(sys.modules, "mujoco.studio", None)
    with pytest.raises(ResourceError, match=r"pip install 'yamsim\[photo\]'"):
        require_filament()


def test_a_driver_that_fails_or_hangs_is_one_line(monkeypatch: pytest.MonkeyPatch, fresh_filament: None) -> None:
    monkeypatch.setattr(filament_context, "require_library", lambda *names: None)

    def fail(*args: object, **options: object) -> SimpleNamespace:
        return SimpleNamespace(returncode=-6, stdout="", stderr="in createVkInstance:985\nreason: no driver\n")

    monkeypatch.setattr(filament_context.subprocess, "run", fail)
    with pytest.raises(ResourceError, match=r"none works here \(reason: no driver\); on Debian .*mesa-vulkan-drivers"):
        require_filament()

    def hang(*args: object, **options: object) -> SimpleNamespace:
        raise subprocess.TimeoutExpired("python", 60)

    monkeypatch.setattr(filament_context.subprocess, "run", hang)
    with pytest.raises(ResourceError, match="hangs: no answer after 60 s"):
        require_filament()


def test_the_device_is_that_of_filaments_report(monkeypatch: pytest.MonkeyPatch, fresh_filament: None) -> None:
    monkeypatch.setattr(filament_context, "require_library", lambda *names: None)
    report = "FEngine resolved backend: Vulkan\nSelected physical device 'A GPU (7)' from 2 physical devices.\n"
    done = SimpleNamespace(returncode=0, stdout=report, stderr="")
    monkeypatch.setattr(filament_context.subprocess, "run", lambda *args, **options: done)
    assert require_filament() == "A GPU (7)"


def test_doctor_says_whether_it_works(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "require_filament", lambda: "A GPU")
    check = doctor._check_photo()
    assert (check.health, check.detail) == (
        "ok",
        "--quality photo works, by A GPU; it takes up to 1.5 GB of memory more for each renderer of a worker",
    )

    def fail() -> str:
        raise ResourceError("--quality photo needs a driver; install one")

    monkeypatch.setattr(doctor, "require_filament", fail)
    check = doctor._check_photo()
    assert (check.health, check.detail) == ("ok", "does not work: --quality photo needs a driver; install one")


@pytest.mark.render
@pytest.mark.parametrize("command", [("render-views",), ("record", "--n", "1", "--size", "32x32", "--workers", "1")])
def test_commands_refuse_it_without_a_driver(command: tuple[str, ...], tmp_path: Path) -> None:
    nothing = {"VK_ICD_FILENAMES": "/nonexistent", "VK_DRIVER_FILES": "/nonexistent"}
    run = yamsim(*command, "--quality", "photo", "--out", "out", cwd=tmp_path, env=nothing, fresh=True)
    assert (run.code, run.out) == (4, "")
    assert "mesa-vulkan-drivers" in run.message or "yamsim[photo]" in run.message
    assert list(tmp_path.iterdir()) == []
