from __future__ import annotations

import os
from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.randomization import RandomizationConfig, SurfaceRanges
from yamsim_cli.core.config.recording import SCENE_CAMERA, RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.config.variation import RandomizationSample, SurfaceSample
from yamsim_cli.core.episode.simulator import SimulatorCache
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import quat_from_rotation, rotation_z
from yamsim_cli.core.scene.build import build_scene
from yamsim_cli.core.scene.randomization_sampling import sample_randomization
from yamsim_cli.core.scene.randomized_model import RandomizedModel, scale_masses, texture_image
from yamsim_cli.procedural.walls import WALL_NAMES
from yamsim_cli.session_opener import SessionOpener

THINGS = {"drawer": "cabinet", "onto_napkin": "piece", "lift_tray": "tray"}
STATISTICS = ("extent", "center", "meaninertia", "meanmass", "meansize")
GREY, RED = (0.5, 0.5, 0.5), (0.8, 0.1, 0.1)


@pytest.fixture(scope="module")
def config(make_config: Callable[..., RecordConfig]) -> RecordConfig:
    floor = {"saturation": [0, 1], "value": [0, 1], "contrast": [0, 1], "textures": {"noise": 1, "plain": 1}}
    return make_config({("randomization",): "default", ("randomization", "floor"): floor})


@pytest.fixture(scope="module")
def model(config: RecordConfig, locations: Locations) -> mujoco.MjModel:
    return build_scene(Session(config, locations)).model


@pytest.fixture(scope="module")
def only(model: mujoco.MjModel, config: RecordConfig) -> RandomizedModel:
    return RandomizedModel(model, config.randomization, config.scene)


@pytest.fixture
def varied(only: RandomizedModel) -> RandomizedModel:
    only.apply_randomization(RandomizationSample())
    return only


def numbers(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """All arrays of a model except its textures' pixels, and its statistics."""
    names = [name for name in dir(model) if isinstance(getattr(model, name), np.ndarray) and name != "tex_data"]
    arrays = {name: getattr(model, name).copy() for name in names}
    arrays |= {name: np.array(getattr(model.stat, name)) for name in STATISTICS}
    return arrays | {name: getattr(model.vis.headlight, name).copy() for name in ("ambient", "diffuse", "specular")}


def changed(before: dict[str, np.ndarray], after: dict[str, np.ndarray]) -> set[str]:
    return {name for name in before if not np.array_equal(before[name], after[name])}


def test_nothing_stays_of_an_attempt(model: mujoco.MjModel, varied: RandomizedModel, config: RecordConfig) -> None:
    before = numbers(model)
    for k in range(5):
        varied.apply_randomization(
            sample_randomization(config.randomization, AttemptJob(0, k), config.scene.lights, config.task.objects, ())
        )
        varied.place_distractor("mug", (0.6, 0.2, 0.0, 1.0))
        assert changed(before, numbers(model))
    varied.apply_randomization(RandomizationSample())
    assert changed(before, numbers(model)) == set()


def test_only_mass_and_friction_touch_physics(
    model: mujoco.MjModel, varied: RandomizedModel, config: RecordConfig
) -> None:
    before = numbers(model)
    ranges = config.randomization.model_copy(update={"mass": None, "friction": None})
    varied.apply_randomization(
        sample_randomization(ranges, AttemptJob(0, 0), config.scene.lights, config.task.objects, ())
    )
    looks = ("light_", "mat_", "cam_", "geom_matid", "geom_group", "ambient", "diffuse")
    assert all(name.startswith(looks) for name in changed(before, numbers(model)))


@pytest.fixture(scope="module")
def drawers() -> mujoco.MjModel:
    """A scene with a cabinet that has a drawer, and a cube."""
    return scene_of("drawer")


def scene_of(task: str) -> mujoco.MjModel:
    opener = SessionOpener(os.environ, lambda text: None, lambda setting: f"--{setting}")
    where = opener.find_locations()
    session = Session(opener.load_record_config("default", where, task=task, quality="fast"), where).without_meshes()
    with SimulatorCache(session) as simulators:
        return simulators.get(AttemptJob(0, 0)).scene.model


@pytest.mark.parametrize("task", THINGS)
def test_factor_1_changes_no_number_of_a_model(task: str) -> None:
    model = scene_of(task)
    before = numbers(model)
    scale_masses(model, {THINGS[task]: 1.0})
    assert changed(before, numbers(model)) == set()


@pytest.mark.parametrize("factor", [0.5, 1.7])
def test_all_bodies_of_a_thing_get_heavier_alike(drawers: mujoco.MjModel, factor: float) -> None:
    before = numbers(drawers)
    own = np.array([drawers.body(int(root)).name == "cabinet" for root in drawers.body_rootid])
    assert own.sum() == 2, "the cabinet and its drawer"
    scale_masses(drawers, {"cabinet": factor})
    after = numbers(drawers)
    factors = np.where(own, factor, 1.0)
    np.testing.assert_allclose(after["body_mass"], before["body_mass"] * factors)
    np.testing.assert_allclose(after["body_inertia"], before["body_inertia"] * factors[:, None])
    np.testing.assert_allclose(after["body_subtreemass"][own], before["body_subtreemass"][own] * factor)
    assert after["body_subtreemass"][0] == pytest.approx(after["body_mass"].sum())
    joint = drawers.joint("cabinet_drawer").dofadr[0]
    # The joint moves the drawer's mass and its own armature.
    armature = drawers.dof_armature[joint]
    moved = factor * (before["dof_M0"][joint] - armature) + armature
    np.testing.assert_allclose(after["dof_M0"][joint], moved)
    # A fixed base is very heavy, but not rigid.
    np.testing.assert_allclose(1 / after["dof_invweight0"][joint], moved, rtol=1e-4)
    masses = {"body_mass", "body_inertia", "body_subtreemass", "body_invweight0", "dof_M0", "dof_invweight0"}
    assert changed(before, after) == masses | {"cam_poscom0", "light_poscom0"}
    scale_masses(drawers, {"cabinet": 1 / factor})


def test_friction_is_that_of_all_of_an_objects_surface(model: mujoco.MjModel, varied: RandomizedModel) -> None:
    before = model.geom_friction.copy()
    varied.apply_randomization(RandomizationSample(friction={"banana": 0.5, "table": 2.0}))
    for geom in range(model.ngeom):
        body, name = model.body(int(model.geom_bodyid[geom])).name, model.geom(geom).name
        factor = 0.5 if body == "banana" else 2.0 if name == "table" else 1.0
        np.testing.assert_allclose(model.geom_friction[geom], before[geom] * [factor, 1, 1])


def test_the_camera_moves_and_turns_about_the_worlds_axes(model: mujoco.MjModel, varied: RandomizedModel) -> None:
    camera = model.cam(SCENE_CAMERA)
    before, quat, fovy = camera.pos.copy(), camera.quat.copy(), float(camera.fovy[0])
    varied.apply_randomization(RandomizationSample(lens_deg=2.0, camera=(0.1, 0.0, -0.2, 0.0, 0.0, 0.3)))
    np.testing.assert_allclose(camera.pos - before, (0.1, 0.0, -0.2))
    assert float(camera.fovy[0]) == fovy + 2.0
    expected = np.empty(4)
    mujoco.mju_mulQuat(expected, quat_from_rotation(rotation_z(0.3)), quat)
    assert abs(expected @ camera.quat) == pytest.approx(1)


def test_a_plain_surface_needs_no_texture(model: mujoco.MjModel, varied: RandomizedModel) -> None:
    varied.apply_randomization(RandomizationSample(table=SurfaceSample("plain", (RED, RED), 3, 0)))
    assert varied.textures == []
    material = model.material(int(model.geom("table").matid[0]))
    assert material.name == "table"
    np.testing.assert_allclose(material.rgba[:3], RED, atol=1e-6)


def test_a_texture_is_in_the_model_and_named(model: mujoco.MjModel, varied: RandomizedModel) -> None:
    surface = SurfaceSample("noise", (GREY, RED), 3, 7)
    varied.apply_randomization(RandomizationSample(table=surface, floor=surface))
    assert varied.textures == [model.texture("table_textured").id, model.texture("floor_textured").id]
    assert model.material(int(model.geom("table").matid[0])).name == "table_textured"
    start, image = int(model.tex_adr[varied.textures[0]]), texture_image(surface)
    np.testing.assert_array_equal(model.tex_data[start : start + image.size], image.ravel())
    assert model.geom("floor_tiles").group[0] > 2


def test_a_checkered_floor_is_its_tiles(model: mujoco.MjModel, varied: RandomizedModel) -> None:
    varied.apply_randomization(RandomizationSample(floor=SurfaceSample("checker", (GREY, RED), 3, 0)))
    assert varied.textures == []
    np.testing.assert_allclose(model.material("floor").rgba[:3], GREY, atol=1e-6)
    np.testing.assert_allclose(model.material("floor_tiles").rgba[:3], RED, atol=1e-6)


def test_distractors_add_no_degree_of_freedom(
    model: mujoco.MjModel, varied: RandomizedModel, make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    plain = build_scene(Session(make_config(), locations)).model
    assert (model.nq, model.nv, model.nu, model.neq) == (plain.nq, plain.nv, plain.nu, plain.neq)


def test_an_absent_distractor_is_nowhere(model: mujoco.MjModel, varied: RandomizedModel) -> None:
    mug = model.body("mug")
    geoms = np.flatnonzero(model.geom_bodyid == mug.id)
    varied.place_distractor("mug", (0.4, 0.1, 0.0, 0.0))
    assert (model.geom_contype[geoms] == 1).any()
    assert (model.geom_group[geoms] <= 2).any()
    varied.place_distractor("mug", None)
    assert not model.geom_contype[geoms].any()
    assert not model.geom_conaffinity[geoms].any()
    assert (model.geom_group[geoms] > 3).all()
    assert mug.pos[2] < -1


@pytest.mark.parametrize("texture", ["plain", "checker", "gradient", "noise"])
def test_patterns_are_made_of_their_two_colours(texture: str) -> None:
    image = texture_image(SurfaceSample(texture, ((0.2, 0.2, 0.2), (0.8, 0.4, 0.2)), 3, 5), 64).astype(int)
    assert image.shape == (64, 64, 3)
    low, high = (51, 51, 51), ((51, 51, 51) if texture == "plain" else (204, 102, 51))
    assert (image.reshape(-1, 3).min(0) >= np.minimum(low, high)).all()
    assert (image.reshape(-1, 3).max(0) <= np.maximum(low, high)).all()
    assert texture == "plain" or image[..., 0].std() > 10


def test_a_checkerboard_repeats_as_often_as_it_says() -> None:
    image = texture_image(SurfaceSample("checker", ((0, 0, 0), (1, 1, 1)), 4, 5), 64)
    assert (np.diff(image[0, :, 0].astype(int)) != 0).sum() == 2 * 4 - 1


def test_noise_can_be_repeated_without_a_seam() -> None:
    image = texture_image(SurfaceSample("noise", ((0, 0, 0), (1, 1, 1)), 3, 5)).astype(int)[..., 0]
    inside = np.abs(np.diff(image, axis=0)).max()
    assert np.abs(image[0] - image[-1]).max() <= inside + 2
    assert np.abs(image[:, 0] - image[:, -1]).max() <= inside + 2


def test_walls_are_there_only_with_their_ranges_and_touch_nothing(config: RecordConfig, locations: Locations) -> None:
    ranges = SurfaceRanges(saturation=(0, 1), value=(0, 1), contrast=(0, 1), textures={"wood": 1})
    with_walls = RandomizationConfig(name="walls", walls=ranges)
    model = build_scene(Session(config.model_copy(update={"randomization": with_walls}), locations)).model
    walls = [model.geom(name) for name in WALL_NAMES]
    assert not any(wall.contype[0] or wall.conaffinity[0] for wall in walls)
    varied = RandomizedModel(model, with_walls, config.scene)
    varied.apply_randomization(RandomizationSample(walls=SurfaceSample("wood", (GREY, RED), 3, 0)))
    assert {int(model.geom(name).matid[0]) for name in WALL_NAMES} == {model.material("walls_textured").id}
    varied.apply_randomization(RandomizationSample())
    assert {int(model.geom(name).matid[0]) for name in WALL_NAMES} == {model.material("walls").id}
