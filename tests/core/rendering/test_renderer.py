from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import mujoco
import numpy as np
import pytest

from tests.attempts import start_of
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.config.task_objects import Role
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.camera import project_points
from yamsim_cli.core.geometry.se3 import invert_pose
from yamsim_cli.core.rendering.renderer import SceneRenderer
from yamsim_cli.core.scene.assets import AssetStore, load_lock
from yamsim_cli.core.scene.build import build_scene
from yamsim_cli.core.scene.compiled import CompiledScene
from yamsim_cli.core.sim.state_replay import StateReplay

pytestmark = pytest.mark.render
SIZE = (640, 480)


@pytest.fixture(scope="module")
def simulator(make_config: Callable[..., RecordConfig], locations: Locations) -> Simulator:
    # Round enough that the centroid of the picture is that of a ball.
    return Simulator(Session(make_config({("wrist",): True, ("render", "slices"): 32}), locations))


@pytest.fixture(scope="module")
def scene(simulator: Simulator) -> CompiledScene:
    return simulator.scene


@pytest.fixture(scope="module")
def renderer(scene: CompiledScene) -> Iterator[SceneRenderer]:
    with SceneRenderer(scene.model, SIZE) as renderer:
        yield renderer


@pytest.fixture(scope="module")
def replica(simulator: Simulator) -> StateReplay:
    return replica_of(simulator)


def replica_of(simulator: Simulator) -> StateReplay:
    """The scene with a seed's objects, ready to render."""
    simulator.state_replay.set_state(start_of(simulator))
    return simulator.state_replay


def test_images_have_the_size_asked_for(renderer: SceneRenderer, replica: StateReplay, scene: CompiledScene) -> None:
    for camera in scene.cameras:
        image = renderer.render(replica.data, camera)
        assert image.shape == (480, 640, 3)
        assert image.dtype == np.uint8
        assert image.std() > 20


def test_drawing_again_gives_the_same_bytes(renderer: SceneRenderer, replica: StateReplay) -> None:
    first = renderer.render(replica.data, "scene_camera").copy()
    renderer.render(replica.data, "right_wrist_camera")
    assert (renderer.render(replica.data, "scene_camera") == first).all()


def test_cameras_are_where_the_record_says(renderer: SceneRenderer, replica: StateReplay, scene: CompiledScene) -> None:
    """A ball at a known point appears where intrinsics and extrinsics put it, within a tenth of a pixel."""
    model = scene.model
    K = renderer.intrinsics("scene_camera").K
    T_cam_in_base = replica.T_cam_in_base("scene_camera")
    for point in ([0.4, 0.1, 0.25], [0.5, -0.2, 0.15], [0.3, 0.25, 0.3]):
        seen = _ball_centroid(model, replica.data, renderer, np.array(point))
        (expected,) = project_points(K, (invert_pose(T_cam_in_base) @ [*point, 1])[None, :3])
        np.testing.assert_allclose(seen, expected, atol=0.1)


def _ball_centroid(
    model: mujoco.MjModel, data: mujoco.MjData, renderer: SceneRenderer, point: np.ndarray
) -> np.ndarray:
    """Centroid in pixels of a ball of 1 cm at a point, from the difference of two pictures."""
    scene = renderer._scene
    images = []
    for with_ball in (False, True):
        renderer._update_scene(data, "scene_camera")
        if with_ball:
            geom = scene.geoms[scene.ngeom]
            mujoco.mjv_initGeom(
                geom,
                mujoco.mjtGeom.mjGEOM_SPHERE,
                np.array([0.01, 0, 0]),
                point,
                np.eye(3).ravel(),
                np.array([1, 0, 1, 1], dtype=np.float32),
            )
            geom.emission = 1.0
            geom.castshadow = 0
            scene.ngeom += 1
        images.append(renderer._average_pixels(renderer._render_whole_image())[::-1].astype(int))
    rows, columns = np.nonzero(np.abs(images[1] - images[0]).max(axis=2) > 30)
    assert len(rows) > 50
    return np.array([columns.mean(), rows.mean()])


def test_wrist_camera_sees_both_fingers(renderer: SceneRenderer, replica: StateReplay) -> None:
    K = renderer.intrinsics("right_wrist_camera").K
    T_base_in_cam = invert_pose(replica.T_cam_in_base("right_wrist_camera"))
    for side in ("left", "right"):
        tip = replica.data.geom(f"{side}_finger_tip_b1").xpos
        ((u, v),) = project_points(K, (T_base_in_cam @ [*tip, 1])[None, :3])
        assert 0 < u < 640
        assert 0 < v < 480


def test_a_renderer_that_cannot_be_made_is_a_missing_resource(scene: CompiledScene) -> None:
    class Broken:
        def __init__(self, *args: object, **kwargs: object) -> None:
            raise ImportError("Cannot initialize a EGL device display.")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mujoco, "GLContext", Broken)
        with pytest.raises(ResourceError, match=r"no OpenGL context.*EGL device display"):
            SceneRenderer(scene.model, SIZE)


def test_closing_twice_is_harmless(scene: CompiledScene) -> None:
    renderer = SceneRenderer(scene.model, (64, 48))
    renderer.close()
    renderer.close()


@pytest.mark.parametrize("size", [(640, 480), (333, 250)])
def test_a_fine_picture_shows_the_same_at_the_same_place(
    make_config: Callable[..., RecordConfig], locations: Locations, size: tuple[int, int]
) -> None:
    """Averaged from 1.5 times the size, which is rounded for odd sizes."""
    changes = {("image", "size_px"): list(size), ("render", "supersampling"): 1.5}
    config = make_config(changes)
    replica = replica_of(Simulator(Session(config, locations)))
    pictures, ids, depths = [], [], []
    for fine in (None, config.render.fine_size(size)):
        with SceneRenderer(replica.scene.model, size, fine) as renderer:
            pictures.append(renderer.render(replica.data, "scene_camera").astype(float))
            ids.append(renderer.render_geom_ids(replica.data, "scene_camera"))
            depths.append(renderer.render_depth(replica.data, "scene_camera"))
    plain, averaged = pictures
    assert plain.shape == averaged.shape == (size[1], size[0], 3)
    assert 0 < np.abs(plain - averaged).mean() < 2
    window = cv2.createHanningWindow(size, cv2.CV_64F)
    (shift, _) = cv2.phaseCorrelate(plain.mean(axis=2), averaged.mean(axis=2), window)
    assert np.hypot(*shift) < 0.1
    # Steps between pixels are smaller, as intended.
    assert np.abs(np.diff(averaged, axis=1)).mean() < np.abs(np.diff(plain, axis=1)).mean()
    # Labels are not averaged.
    assert (ids[0] == ids[1]).all()
    assert (depths[0] == depths[1]).all()


def test_an_image_is_written_where_it_is_wanted(renderer: SceneRenderer, replica: StateReplay) -> None:
    image = np.zeros((480, 640, 3), np.uint8)
    assert renderer.render(replica.data, "scene_camera", image) is image
    assert (image == renderer.render(replica.data, "scene_camera")).all()


def test_depth_is_that_of_the_table(renderer: SceneRenderer, replica: StateReplay, config: RecordConfig) -> None:
    """On the table, each pixel's ray reaches the top's plane at the measured depth."""
    seen = renderer.render_geom_ids(replica.data, "scene_camera") == replica.scene.model.geom("table").id
    rows, columns = np.nonzero(seen)
    depth = renderer.render_depth(replica.data, "scene_camera")[rows, columns]
    K = renderer.intrinsics("scene_camera").K
    rays = np.column_stack([columns, rows, np.ones(len(rows))]) @ np.linalg.inv(K).T
    points = replica.T_cam_in_base("scene_camera")[:3] @ np.column_stack([rays * depth[:, None], np.ones(len(rows))]).T
    heights = points[2] + replica.scene.T_base_in_world[2, 3]
    # Except for the few pixels of its edge.
    assert np.quantile(np.abs(heights - config.widened_table.top_height), 0.9) < 2e-4


def test_a_buffer_that_is_too_small_is_refused(scene: CompiledScene) -> None:
    with pytest.raises(ValueError, match="offscreen buffer is smaller than 1280 x 960"):
        SceneRenderer(scene.model, (640, 480), (1280, 960))


FLAT = ("table", "safety_plane", "floor_tiles")


def shadows_on(
    names: Sequence[str],
    config: RecordConfig,
    locations: Locations,
    *,
    meshes: Mapping[str, Path | None] | None = None,
    all_cast: bool = False,
) -> np.ndarray:
    """Areas in pixels of the patches of some geoms that shadows darken.

    Patches along an edge are omitted: a shadow behind a rim shows there as a row of single pixels.
    """
    pictures = []
    for shadow_map in (config.render.shadow_map_px, 0):
        render = config.render.model_copy(update={"shadow_map_px": shadow_map})
        where = replace(locations, meshes=meshes or {})
        simulator = Simulator(Session(config.model_copy(update={"render": render}), where))
        model = simulator.scene.model
        if all_cast:
            model.geom_castshadow[:] = 1
        replica = replica_of(simulator)
        with SceneRenderer(model, SIZE, render.fine_size(SIZE)) as renderer:
            pictures.append(renderer.render(replica.data, "scene_camera").astype(int))
            ids = renderer.render_geom_ids(replica.data, "scene_camera")
    geoms = [model.geom(name).id for name in names]
    inside = cv2.erode(np.isin(ids, geoms).astype(np.uint8), np.ones((3, 3), np.uint8))
    dark = ((pictures[1] - pictures[0]).mean(axis=2) > 10) & np.isin(ids, geoms)
    _, patches, stats, _ = cv2.connectedComponentsWithStats(dark.astype(np.uint8), connectivity=8)
    away_from_edges = np.setdiff1d(patches[inside > 0], [0])
    return stats[away_from_edges, cv2.CC_STAT_AREA]


@pytest.mark.parametrize("preset", ["fast", "balanced", "high"])
def test_every_preset_has_shadows_without_acne(
    preset: str, make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    """On table and floor, shadows are a few patches, without dots."""
    areas = shadows_on(FLAT, make_config({("render",): preset}), locations)
    assert areas.sum() > 500
    assert areas.max() > 200
    assert (areas <= 3).sum() <= 10


def test_acne_would_be_seen(make_config: Callable[..., RecordConfig], locations: Locations) -> None:
    """With shadows of table and floor onto themselves, both would be full of dots."""
    areas = shadows_on(FLAT, make_config({("render",): "fast"}), locations, all_cast=True)
    assert (areas <= 3).sum() > 50


@pytest.fixture(scope="module")
def scans(locations: Locations) -> dict[str, Path | None]:
    """The folder of YCB's scans."""
    folder = AssetStore(locations.assets).find_verified_folder(load_lock(locations).sets["ycb"])
    if folder is None:
        pytest.skip("the scans are not here: yamsim assets fetch")
    return {"ycb": folder}


@pytest.mark.parametrize("preset", ["fast", "high"])
def test_the_plate_does_not_speckle_itself(
    preset: str, make_config: Callable[..., RecordConfig], locations: Locations, scans: dict[str, Path | None]
) -> None:
    """If its scan cast a shadow, grazing light would leave dots on it."""
    config = make_config({("render",): preset})
    (plate,) = config.task.things["target"].of
    mesh = plate.mesh.model_copy(update={"castshadow": True})
    target = Role(of=(plate.model_copy(update={"mesh": mesh}),), named="object")
    things = {**config.task.things, "target": target}
    casting = config.model_copy(update={"task": config.task.model_copy(update={"things": things})})
    dots, speckles = (
        int((shadows_on(["plate_look"], one, locations, meshes=scans) <= 3).sum()) for one in (config, casting)
    )
    assert dots * 3 <= speckles >= 5


def test_shadows_reach_as_far_as_a_quality_says(make_config: Callable[..., RecordConfig], locations: Locations) -> None:
    far, near = (
        build_scene(Session(make_config({("render", "shadow_reach_m"): reach}), locations)).model.vis.map.shadowclip
        for reach in (0.8, 0.65)
    )
    assert (far, near) == pytest.approx((0.8, 0.65))


def test_a_renderer_that_was_not_closed_ends_silently() -> None:
    script = (
        "import mujoco\n"
        "from yamsim_cli.core.rendering.renderer import SceneRenderer\n"
        "model = mujoco.MjModel.from_xml_string('<mujoco/>')\n"
        "renderer = SceneRenderer(model, (16, 16))\n"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert (run.returncode, run.stderr) == (0, "")


# An interpreter that has not rendered yet; `child` returns the result of a function in a forked process.
SCRIPT = """
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
import mujoco
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.core.rendering.renderer import SceneRenderer

SCENE = "<mujoco><worldbody><light pos='0 0 3'/><geom size='1'/><camera name='c' pos='0 -5 0' xyaxes='1 0 0 0 0 1'/>"
model = mujoco.MjModel.from_xml_string(SCENE + "</worldbody></mujoco>")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)


def draw(renderer=None):
    try:
        return f"drew {(renderer or SceneRenderer(model, (32, 24))).render(data, 'c').std() > 5}"
    except ResourceError as error:
        return f"refused: {error}"


def draw_with_the_parents():
    return draw(mine)


def child(function, *arguments):
    with ProcessPoolExecutor(1, multiprocessing.get_context("fork")) as pool:
        return pool.submit(function, *arguments).result(timeout=30)


"""


def printed_by(script: str) -> list[str]:
    """Lines that a script prints after `SCRIPT`."""
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT + script], capture_output=True, text=True, timeout=100, check=False
    )
    assert run.returncode == 0, run.stderr
    return run.stdout.splitlines()


def test_a_process_forked_from_one_that_drew_is_refused_with_what_to_do() -> None:
    lines = printed_by(
        "mine = SceneRenderer(model, (32, 24))\n"
        "print(draw(mine))\n"
        "print(child(draw))\n"
        "print(child(draw_with_the_parents))\n"
        "print(child(child, draw))\n"
        "mine.close()\n"
        "print(child(draw))\n"
        "print(draw())\n"
    )
    # The parent goes on rendering.
    assert (lines[0], lines[-1]) == ("drew True", "drew True")
    assert len(lines) == 6
    for line in lines[1:-1]:
        assert line.startswith("refused: process ")
        assert 'context="forkserver"' in line and "'spawn'" in line


def test_what_mujocos_own_renderer_drew_counts() -> None:
    lines = printed_by("theirs = mujoco.Renderer(model, 16, 16)\nprint(child(draw))\nprint(draw())\n")
    assert lines[0].startswith("refused: ")
    assert lines[1] == "drew True"


@pytest.mark.slow
def test_forks_of_what_has_drawn_nothing_draw() -> None:
    assert printed_by("print(child(draw))\nprint(child(child, draw))\nprint(draw())\n") == ["drew True"] * 3
