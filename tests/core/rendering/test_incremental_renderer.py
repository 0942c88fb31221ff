"""Images of which only the changed part is drawn have the same pixels as whole ones."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from typing import Any

import mujoco
import numpy as np
import pytest

from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.execution import simulate_expert
from yamsim_cli.core.episode.sampling import sample_attempt
from yamsim_cli.core.episode.simulator import SimulatorCache
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.rendering import shadow_shaders
from yamsim_cli.core.rendering.incremental_renderer import IncrementalRenderer
from yamsim_cli.core.rendering.pixel_boxes import Projection, ScissorBox, ShadowTable, ShadowVolumes, box_corners, union
from yamsim_cli.core.rendering.renderer import SceneRenderer
from yamsim_cli.session_opener import SessionOpener

SIZE = (320, 240)


def open_session(**settings: Any) -> Session:
    opener = SessionOpener({**os.environ, "YAMSIM_ASSETS": os.devnull}, lambda line: None, str)
    where = opener.find_locations()
    return Session(opener.load_record_config("default", where, quality="balanced", **settings), where).without_meshes()


def draw_all(renderer: SceneRenderer, model: mujoco.MjModel, states: Sequence[Array], cameras: Sequence[str]) -> Array:
    data, images = mujoco.MjData(model), []
    for qpos in states:
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        images += [renderer.render(data, camera) for camera in cameras]
        renderer.render_depth(data, cameras[0])  # which MuJoCo draws in between
    return np.array(images)


@pytest.mark.render
@pytest.mark.parametrize("smooth", [False, True], ids=["stepped", "smooth"])
@pytest.mark.parametrize(
    "settings",
    [
        {"task": "pickplace", "wrist": True, "boards": True},
        pytest.param({"task": "handover", "rig": "russet", "wrist": True}, marks=pytest.mark.slow),
        pytest.param({"task": "fold_napkin"}, marks=pytest.mark.slow),
        pytest.param({"task": "tower", "randomize": "default", "seed": 3}, marks=pytest.mark.slow),
    ],
    ids=["pickplace", "handover", "fold_napkin", "tower"],
)
def test_the_pixels_are_those_of_whole_images(
    settings: dict[str, Any], smooth: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    boxes: list[ScissorBox | None] = []
    draw = IncrementalRenderer.draw

    def record_box(self: IncrementalRenderer, data: mujoco.MjData, camera: str) -> ScissorBox | None:
        boxes.append(draw(self, data, camera))
        return boxes[-1]

    monkeypatch.setattr(IncrementalRenderer, "draw", record_box)
    with SimulatorCache(open_session(**settings)) as simulators:
        job = AttemptJob(settings.get("seed", 0), 0)
        simulator = simulators.get(job)
        states = [s.qpos for s in simulate_expert(simulator, sample_attempt(simulator, job)).recorded_states[::10]]
        model, cameras = simulator.scene.model, simulator.scene.cameras
        fine = simulator.config.render.fine_size(SIZE)
        images = []
        for incremental in (True, False):
            with SceneRenderer(model, SIZE, fine, incremental=incremental, smooth_shadows=smooth) as renderer:
                images.append(draw_all(renderer, model, states, cameras))
    np.testing.assert_array_equal(*images)
    if boxes:  # a GPU draws whole images
        del boxes[len(images[0]) :]
        shares = [box.width * box.height / (fine[0] * fine[1]) for box in boxes[:: len(cameras)] if box is not None]
        assert len(shares) == len(states)
        assert np.mean(shares) < 0.7


@pytest.fixture
def pickplace_start() -> Iterator[tuple[mujoco.MjModel, str, Array]]:
    """The model of `pickplace`, its first camera, and the positions at the start of an attempt."""
    with SimulatorCache(open_session(task="pickplace")) as simulators:
        simulator = simulators.get(AttemptJob(0, 0))
        start = sample_attempt(simulator, AttemptJob(0, 0)).start
        assert start is not None
        yield simulator.scene.model, simulator.scene.cameras[0], start


@pytest.mark.render
def test_smooth_shadows_differ_only_at_edges_of_shadows_and_have_grey_levels(
    pickplace_start: tuple[mujoco.MjModel, str, Array],
) -> None:
    model, camera, start = pickplace_start
    pictures = []
    for smooth in (False, True):
        with SceneRenderer(model, SIZE, smooth_shadows=smooth) as renderer:
            pictures.append(draw_all(renderer, model, [start], [camera])[0].astype(int))
    difference = np.abs(pictures[1] - pictures[0]).max(axis=2)
    assert (difference > 1).mean() < 0.02
    # Filtering gives levels between light and shadow, so many pixels change by less than a whole shadow.
    edge = difference[difference > 1]
    assert len(np.unique(edge)) > 10
    assert np.median(edge) < edge.max() / 2


@pytest.mark.render
def test_without_the_programs_shadows_have_steps_and_a_warning_says_so(
    pickplace_start: tuple[mujoco.MjModel, str, Array],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    def refuse(*arguments: Any) -> int:
        raise RuntimeError("no GLSL 1.20")

    model, camera, start = pickplace_start
    pictures = []
    for smooth in (False, True):
        monkeypatch.setattr(shadow_shaders, "_link", refuse)
        shadow_shaders.warn_of_stepped_shadows.cache_clear()
        with SceneRenderer(model, SIZE, smooth_shadows=smooth) as renderer:
            pictures.append(draw_all(renderer, model, [start, start], [camera]))
        assert ("no GLSL 1.20" in caplog.text) == smooth
    np.testing.assert_array_equal(*pictures)
    assert len(caplog.records) == 1


@pytest.mark.render
def test_an_image_follows_colours_lights_and_the_camera() -> None:
    with SimulatorCache(open_session(task="pickplace")) as simulators:
        simulator = simulators.get(AttemptJob(0, 0))
        model, (camera, *_) = simulator.scene.model, simulator.scene.cameras
        attempt = sample_attempt(simulator, AttemptJob(0, 0))
        assert attempt.start is not None
        states = [attempt.start]
        fine = simulator.config.render.fine_size(SIZE)
        with SceneRenderer(model, SIZE, fine) as part, SceneRenderer(model, SIZE, fine, incremental=False) as whole:
            before = draw_all(part, model, states, [camera])
            headlight = model.vis.headlight.diffuse
            for change in (model.mat_rgba, model.light_diffuse, headlight, model.light_dir, model.cam_pos):
                change += 0.05
                after = draw_all(part, model, states, [camera])
                assert (after != before).any()
                np.testing.assert_array_equal(after, draw_all(whole, model, states, [camera]))
                before = after


def test_a_box_contains_the_projected_points() -> None:
    matrix = np.array([[2.0, 0, 0, 0], [0, 2.0, 0, 0], [0, 0, 0, 0], [0, 0, -1, 0]])  # looks along -z
    projection = Projection(matrix, 0, (200, 100), (200, 100), margin=2)
    corners = box_corners(
        np.array([[0, 0, 0, 0.1, 0.1, 0.1]] * 2), np.array([[0, 0, -2.0], [0, 0, 2.0]]), np.eye(3)[None]
    )
    boxes, bounded = projection.boxes(corners)
    # The near face is 1.9 m away: 0.1 m are 10.5 px across and 5.3 px along the image.
    assert boxes[0].tolist() == [87, 42, 113, 58]
    assert bounded.tolist() == [True, False]
    assert boxes[1].tolist() == [0, 0, 200, 100]
    assert union(boxes[:1]) == ScissorBox(87, 42, 26, 16)
    assert union(boxes[:0]).is_empty


def test_a_shadow_ends_on_a_table_that_catches_all_of_it() -> None:
    table = ShadowTable(np.eye(4), np.array([1.0, 1.0, 0.1]))
    volumes = ShadowVolumes(np.array([0.0, 0.0, -1.0]), -0.8, (table,), margin=0.001)
    over, beside = (
        box_corners(np.array([[x, 0, 0.5, 0.1, 0.1, 0.1]]), np.zeros((1, 3)), np.eye(3)[None]) for x in (0.0, 0.95)
    )
    assert volumes.hull_points(over)[0, :, 2].min() == pytest.approx(0.1)
    assert volumes.hull_points(beside)[0, :, 2].min() == pytest.approx(-0.8)
    assert not ShadowVolumes(np.array([1.0, 0.0, 0.0]), 0.0, (), 0.001).is_bounded
