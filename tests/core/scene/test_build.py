from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from yamsim_cli.core.tasks.pickplace import sample_layout

from yamsim_cli.core.config.recording import SCENE_CAMERA, RecordConfig
from yamsim_cli.core.planning.arm_tools import start_stands
from yamsim_cli.core.resources import Locations
from yamsim_cli.core.scene.blueprint import task_blueprint
from yamsim_cli.core.scene.build import build_scene
from yamsim_cli.core.scene.compiled import CompiledScene
from yamsim_cli.core.scene.compose import WELD, mesh_sets
from yamsim_cli.core.session import Session
from yamsim_cli.core.types import Layout


@pytest.fixture(scope="module")
def scene(make_config: Callable[..., RecordConfig], locations: Locations) -> CompiledScene:
    return build_scene(Session(make_config({("wrist",): True}), locations))


def _layout(config: RecordConfig, seed: int) -> Layout:
    layout = sample_layout(config, np.random.default_rng(seed))
    assert layout is not None
    return layout


def _start(scene: CompiledScene, config: RecordConfig, seed: int) -> mujoco.MjData:
    data = mujoco.MjData(scene.model)
    scene.start(data, _layout(config, seed), start_stands(config))
    return data


def test_size_of_the_model(scene: CompiledScene) -> None:
    # Eight joints of the arm and two free bodies.
    assert (scene.model.nq, scene.model.nu) == (8 + 7 + 7, 7)


def test_weld_starts_inactive(scene: CompiledScene, config: RecordConfig) -> None:
    assert not _start(scene, config, 0).eq_active[scene.arm.weld]
    assert scene.model.equality(WELD).id == scene.arm.weld


@pytest.mark.parametrize("seed", range(20))
def test_nothing_is_in_contact_at_the_start(scene: CompiledScene, config: RecordConfig, seed: int) -> None:
    assert _start(scene, config, seed).ncon == 0


@pytest.mark.parametrize("seed", range(5))
def test_settles_without_moving(scene: CompiledScene, config: RecordConfig, seed: int) -> None:
    data = _start(scene, config, seed)
    before = data.qpos.copy()
    mujoco.mj_step(scene.model, data, 1000)
    assert data.ncon > 0
    np.testing.assert_allclose(data.qpos, before, atol=1e-3)
    assert np.abs(data.qvel).max() < 1e-3


def test_reset_leaves_no_trace_of_what_was_before(scene: CompiledScene, config: RecordConfig) -> None:
    fresh, used = _start(scene, config, 1), _start(scene, config, 2)
    mujoco.mj_step(scene.model, used, 300)
    scene.start(used, _layout(config, 1), start_stands(config))
    for data in (fresh, used):
        mujoco.mj_step(scene.model, data, 100)
    assert (fresh.qpos == used.qpos).all()


def test_table_is_clear_of_the_arm(scene: CompiledScene) -> None:
    data = mujoco.MjData(scene.model)
    mujoco.mj_forward(scene.model, data)
    nearest = mujoco.mj_geomDistance(
        scene.model, data, scene.model.geom("base_collide").id, scene.model.geom("table").id, 1.0, None
    )
    assert nearest > 0.05


def test_what_falls_is_caught(scene: CompiledScene, config: RecordConfig) -> None:
    data = _start(scene, config, 0)
    address = scene.object_qpos["banana"]
    data.qpos[address : address + 3] = (0.45, 0.6, 0.2)
    mujoco.mj_step(scene.model, data, 2000)
    assert -0.5 < data.qpos[address + 2] < -0.45


def test_plate_and_banana_have_their_masses(scene: CompiledScene) -> None:
    # Source: the YCB object set's table of masses.
    assert scene.model.body("banana").mass[0] == pytest.approx(0.066)
    assert scene.model.body("plate").mass[0] == pytest.approx(0.279)


def test_banana_collides_as_two_capsules(scene: CompiledScene) -> None:
    geoms = [scene.model.geom(k) for k in range(scene.model.ngeom)]
    solid = [g for g in geoms if scene.model.body(g.bodyid[0]).name == "banana" and g.contype[0]]
    assert [g.type[0] for g in solid] == [mujoco.mjtGeom.mjGEOM_CAPSULE] * 2


def test_a_banana_dropped_onto_the_plate_stays_there(scene: CompiledScene, config: RecordConfig) -> None:
    data = _start(scene, config, 0)
    plate, banana = scene.object_qpos["plate"], scene.object_qpos["banana"]
    data.qpos[banana : banana + 3] = data.qpos[plate : plate + 3]
    data.qpos[banana + 2] += 0.06
    mujoco.mj_step(scene.model, data, 1500)
    offset = data.qpos[banana : banana + 3] - data.qpos[plate : plate + 3]
    assert np.hypot(*offset[:2]) < 0.03
    assert 0.01 < offset[2] < 0.05


def test_cameras(scene: CompiledScene, config: RecordConfig) -> None:
    assert scene.cameras == (SCENE_CAMERA, "right_wrist_camera")
    assert config.wrist is False


def test_wrist_camera_looks_along_the_fingers(scene: CompiledScene, config: RecordConfig) -> None:
    data = _start(scene, config, 0)
    camera, hand = data.cam("right_wrist_camera"), data.body("link_6").xmat.reshape(3, 3)
    forward = -camera.xmat.reshape(3, 3)[:, 2]
    assert forward @ hand[:, 2] == pytest.approx(0.6)
    to_pinch = data.site("pinch_site").xpos - camera.xpos
    assert forward @ to_pinch / np.linalg.norm(to_pinch) > np.cos(np.radians(25))


def test_mesh_sets_are_those_of_arm_and_objects(config: RecordConfig) -> None:
    assert mesh_sets(task_blueprint(config)) == ("i2rt_yam_crank", "ycb")


def test_names_are_unique_and_the_arm_keeps_its_own(scene: CompiledScene) -> None:
    names = [scene.model.geom(k).name for k in range(scene.model.ngeom)]
    assert "" not in names
    assert len(set(names)) == len(names)
    for name in ("arm", "link_1", "link_6"):
        assert scene.model.body(name).id > 0
