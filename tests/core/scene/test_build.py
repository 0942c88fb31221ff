from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from tests.attempts import start_of
from yamsim_cli.core.config.recording import SCENE_CAMERA, RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.scene.blueprint import task_blueprint
from yamsim_cli.core.scene.compiled import CompiledScene
from yamsim_cli.core.scene.compose import WELD_NAME, visual_mesh_sets
from yamsim_cli.core.sim.settling import MAX_REST_SPEED


@pytest.fixture(scope="module")
def simulator(make_config: Callable[..., RecordConfig], locations: Locations) -> Simulator:
    return Simulator(Session(make_config({("wrist",): True}), locations))


@pytest.fixture(scope="module")
def scene(simulator: Simulator) -> CompiledScene:
    return simulator.scene


def _start(simulator: Simulator, seed: int) -> mujoco.MjData:
    data = mujoco.MjData(simulator.scene.model)
    simulator.scene.reset(data, start_of(simulator, seed))
    return data


def test_weld_starts_inactive(simulator: Simulator, scene: CompiledScene) -> None:
    assert not _start(simulator, 0).eq_active[scene.first_arm.weld]
    assert scene.model.equality(WELD_NAME).id == scene.first_arm.weld


@pytest.mark.parametrize("seed", range(20))
def test_only_things_and_table_touch_at_the_start(simulator: Simulator, scene: CompiledScene, seed: int) -> None:
    data = _start(simulator, seed)
    assert data.ncon > 0
    assert not scene.mask_forbidden_contacts(data.contact.geom).any()
    bodies = {scene.model.body(scene.model.geom_bodyid[geom]).name for geom in data.contact.geom.ravel()}
    assert bodies == {"world", "banana", "plate"}
    table = scene.model.geom("table").id
    assert (data.contact.geom == table).any(axis=1).all()


@pytest.mark.parametrize("seed", range(5))
def test_settles_without_moving(simulator: Simulator, scene: CompiledScene, seed: int) -> None:
    data = _start(simulator, seed)
    before = data.qpos.copy()
    mujoco.mj_step(scene.model, data, 1000)
    assert data.ncon > 0
    np.testing.assert_allclose(data.qpos, before, atol=1e-3)
    assert np.abs(data.qvel).max() < MAX_REST_SPEED


def test_reset_leaves_no_trace_of_what_was_before(simulator: Simulator, scene: CompiledScene) -> None:
    fresh, used = _start(simulator, 1), _start(simulator, 2)
    mujoco.mj_step(scene.model, used, 300)
    scene.reset(used, start_of(simulator, 1))
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


def test_what_falls_is_caught(simulator: Simulator, scene: CompiledScene) -> None:
    data = _start(simulator, 0)
    address = scene.object_qpos["banana"]
    data.qpos[address : address + 3] = (0.45, 0.6, 0.2)
    mujoco.mj_step(scene.model, data, 2000)
    assert -0.5 < data.qpos[address + 2] < -0.45


def test_a_banana_dropped_onto_the_plate_stays_there(simulator: Simulator, scene: CompiledScene) -> None:
    data = _start(simulator, 0)
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


def test_wrist_camera_looks_along_the_fingers(simulator: Simulator) -> None:
    data = _start(simulator, 0)
    camera, hand = data.cam("right_wrist_camera"), data.body("link_6").xmat.reshape(3, 3)
    forward = -camera.xmat.reshape(3, 3)[:, 2]
    assert forward @ hand[:, 2] == pytest.approx(0.6)
    to_pinch = data.site("pinch_site").xpos - camera.xpos
    assert forward @ to_pinch / np.linalg.norm(to_pinch) > np.cos(np.radians(25))


def test_mesh_sets_are_those_of_arm_and_objects(config: RecordConfig) -> None:
    assert visual_mesh_sets(task_blueprint(config)) == ("i2rt_yam_crank", "ycb")


def test_a_seen_ring_is_one_thing_to_draw(scene: CompiledScene) -> None:
    model = scene.model
    names = [model.geom(k).name for k in range(model.ngeom)]
    seen = [name for name in names if name.startswith("plate_look")]
    assert seen == ["plate_look_0", "plate_look_1"]
    for name in seen:
        geom = model.geom(name)
        assert geom.type[0] == mujoco.mjtGeom.mjGEOM_MESH
        assert not geom.contype[0]
        assert not geom.conaffinity[0]
