from __future__ import annotations

import errno
import os
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from yamsim_cli.core.config.loader import load_config, parse_config
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.errors import ConfigError, ResourceError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.scene.blueprint import Blueprint, task_blueprint
from yamsim_cli.core.scene.build import build_scene
from yamsim_cli.viewers.show.compose import compose_at_home, first_attempt_start, write_scene
from yamsim_cli.viewers.show.scene_files import scene_files, zip_bytes

RIGS = ("single", "bimanual", "russet")
MOVE = np.array([0.1, 0.2, 0.3])

# Runs without yamsim on the path, as any MuJoCo program.
PLAIN_MUJOCO = """
import sys, mujoco, numpy as np
assert not any(name.startswith("yamsim") for name in sys.modules)
model = mujoco.MjModel.from_xml_path(sys.argv[1])
for key in (None, 0):
    data = mujoco.MjData(model)
    if key is not None:
        mujoco.mj_resetDataKeyframe(model, data, key)
    start = data.qpos.copy()
    mujoco.mj_step(model, data, 1000)
    assert np.isfinite(data.qpos).all()
    assert np.abs(data.qpos - start).max() < 1e-3, np.abs(data.qpos - start).max()
print(model.nq, model.nu)
"""


@pytest.fixture(scope="module")
def studio(locations: Locations) -> SceneConfig:
    return load_config(SceneConfig, "scenes", "studio", locations)


def _rig(name: str, locations: Locations) -> RigConfig:
    return load_config(RigConfig, "rigs", name, locations)


def _compiled(name: str, locations: Locations, studio: SceneConfig) -> tuple[mujoco.MjModel, mujoco.MjData]:
    _, model = compose_at_home(Blueprint(_rig(name, locations), studio), locations)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def _task(
    config: RecordConfig, locations: Locations, *, background: bool = True
) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    """A composed task in its first attempt's start state."""
    config, home = first_attempt_start(Session(config, locations))
    return compose_at_home(task_blueprint(config, background=background), locations, home)


def _in_plain_mujoco(scene: Path) -> str:
    done = subprocess.run(
        [sys.executable, "-I", "-c", PLAIN_MUJOCO, str(scene)], cwd="/", capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.parametrize(("name", "size"), [("single", "8 7"), ("bimanual", "16 14"), ("russet", "16 14")])
def test_a_composed_folder_runs_in_plain_mujoco(
    name: str, size: str, locations: Locations, studio: SceneConfig, tmp_path: Path
) -> None:
    spec, model = compose_at_home(Blueprint(_rig(name, locations), studio), locations)
    write_scene(spec, model, tmp_path / "scene", as_zip=False, overwrite=False)
    # Moved, because the scene must not depend on its original path.
    (tmp_path / "scene").rename(tmp_path / "elsewhere")
    assert _in_plain_mujoco(tmp_path / "elsewhere" / "scene.xml") == size


def test_a_composed_task_of_two_arms_runs_in_plain_mujoco(
    make_config: Callable[..., RecordConfig], locations: Locations, tmp_path: Path
) -> None:
    spec, model = _task(make_config({("rig",): "bimanual"}), locations)
    write_scene(spec, model, tmp_path / "scene", as_zip=False, overwrite=False)
    assert _in_plain_mujoco(tmp_path / "scene" / "scene.xml") == "30 14"


def test_what_is_written_is_what_was_compiled(config: RecordConfig, locations: Locations) -> None:
    spec, model = _task(config, locations)
    files = scene_files(spec, model, "4")
    read = mujoco.MjModel.from_xml_string(files.pop("scene.xml").decode(), files)
    fields = """body_mass body_inertia body_pos body_gravcomp jnt_range dof_armature actuator_gainprm actuator_biasprm
        actuator_ctrlrange actuator_forcerange geom_friction geom_size eq_active0 key_qpos key_ctrl cam_fovy"""
    for field in fields.split():
        np.testing.assert_allclose(getattr(read, field), getattr(model, field), atol=1e-6, err_msg=field)


def test_composing_twice_gives_the_same_bytes(locations: Locations, studio: SceneConfig) -> None:
    one, two = (
        scene_files(*compose_at_home(Blueprint(_rig("russet", locations), studio), locations)) for _ in range(2)
    )
    assert one == two
    assert zip_bytes(one, "scene") == zip_bytes(two, "scene")


def test_every_file_named_is_there_and_every_file_there_is_named(locations: Locations, studio: SceneConfig) -> None:
    files = scene_files(*compose_at_home(Blueprint(_rig("bimanual", locations), studio), locations))
    root = ElementTree.fromstring(files["scene.xml"])
    named = {element.get("file") for element in root.iter() if element.get("file")}
    assert named == set(files) - {"scene.xml"}
    assert not any(Path(name).is_absolute() or ".." in Path(name).parts for name in named if name)


def test_names_are_unique(locations: Locations, studio: SceneConfig) -> None:
    model, _ = _compiled("bimanual", locations, studio)
    for kind, count in (("body", model.nbody), ("geom", model.ngeom), ("joint", model.njnt), ("actuator", model.nu)):
        names = [getattr(model, kind)(k).name for k in range(count)]
        assert len(set(names)) == len(names)
        assert "" not in names


def test_the_second_arm_carries_its_prefix(locations: Locations, studio: SceneConfig) -> None:
    model, data = _compiled("bimanual", locations, studio)
    np.testing.assert_allclose(data.body("arm").xpos, (0, -0.35, 0))
    np.testing.assert_allclose(data.body("arm2_arm").xpos, (0, 0.35, 0))
    assert model.joint("arm2_joint1").id != model.joint("joint1").id


@pytest.mark.parametrize("name", RIGS)
def test_boards_lie_flat_at_their_true_size(name: str, locations: Locations, studio: SceneConfig) -> None:
    model, data = _compiled(name, locations, studio)
    for arm in _rig(name, locations).arms:
        board = data.geom(f"{arm.prefix}base_board")
        np.testing.assert_allclose(board.xmat.reshape(3, 3)[:, 2], (0, 0, 1), atol=1e-9)
        # Source: the printed board's edge, 93.5385 mm.
        np.testing.assert_allclose(model.geom(f"{arm.prefix}base_board").size[:2] * 2, 0.0935385, atol=1e-7)


@pytest.mark.parametrize("name", RIGS)
def test_mount_and_board_follow_a_moved_base(name: str, locations: Locations, studio: SceneConfig) -> None:
    model, data = _compiled(name, locations, studio)
    arm = _rig(name, locations).arms[-1]
    before = {part: data.geom(f"{arm.prefix}{part}").xpos.copy() for part in ("base_board", "base_mount")}
    for part in before:
        mocap = model.body(f"{arm.prefix}{part}").mocapid[0]
        data.mocap_pos[mocap] += MOVE
    mujoco.mj_forward(model, data)
    for part, position in before.items():
        np.testing.assert_allclose(data.geom(f"{arm.prefix}{part}").xpos, position + MOVE, atol=1e-9)


@pytest.mark.parametrize("name", RIGS)
def test_the_mount_does_not_cover_the_board(name: str, locations: Locations, studio: SceneConfig) -> None:
    model, data = _compiled(name, locations, studio)
    for arm in _rig(name, locations).arms:
        board, mount = (f"{arm.prefix}base_{part}" for part in ("board", "mount"))
        group = np.array([0, 0, 1, 0, 0, 0], np.uint8)
        for x in (-0.046, 0.0, 0.046):
            for y in (-0.046, 0.0, 0.046):
                above = data.geom(board).xpos + data.geom(board).xmat.reshape(3, 3) @ (x, y, 0.5)
                hit = np.array([-1], np.int32)
                distance = mujoco.mj_ray(model, data, above, np.array([0.0, 0, -1]), group, 1, -1, hit)
                assert model.geom(int(hit[0])).name in (board, mount)
                assert distance == pytest.approx(0.5, abs=1e-6), "something lies above the board"


def test_boards_can_be_left_out(locations: Locations, studio: SceneConfig) -> None:
    _, bare = compose_at_home(Blueprint(_rig("bimanual", locations), studio, boards=False), locations)
    bodies = {bare.body(k).name for k in range(bare.nbody)}
    assert not any("board" in name or "mount" in name for name in bodies)


def _geoms(model: mujoco.MjModel) -> set[str]:
    return {model.geom(k).name for k in range(model.ngeom)}


def _surroundings(model: mujoco.MjModel) -> dict[str, bool]:
    return {
        "floor": "safety_plane" in _geoms(model),
        "sky": mujoco.mjtTexture.mjTEXTURE_SKYBOX in model.tex_type,
        "lights": model.nlight > 0,
        "dimmed headlight": not np.array_equal(model.vis.headlight.diffuse, mujoco.MjSpec().visual.headlight.diffuse),
    }


@pytest.mark.parametrize("background", [True, False])
def test_the_background_can_be_left_out_and_a_tasks_table_stays(
    background: bool, config: RecordConfig, locations: Locations, studio: SceneConfig, tmp_path: Path
) -> None:
    _, rig = compose_at_home(Blueprint(_rig("bimanual", locations), studio, background=background), locations)
    spec, task = _task(config, locations, background=background)
    for model in (rig, task):
        assert set(_surroundings(model).values()) == {background}, _surroundings(model)
    assert {"table", "post_0", "post_4"} <= _geoms(task)
    write_scene(spec, task, tmp_path / "scene", as_zip=False, overwrite=False)
    assert _in_plain_mujoco(tmp_path / "scene" / "scene.xml") == "22 7"


def test_a_users_rig_from_any_file(locations: Locations, studio: SceneConfig, tmp_path: Path) -> None:
    text = locations.find_data_file("configs/rigs/bimanual.yaml").read_text().replace("margin: 0.7", "margin: 0.5")
    (tmp_path / "mine.yaml").write_text(text)
    rig = load_config(RigConfig, "rigs", str(tmp_path / "mine.yaml"), locations)
    assert rig.name == "mine"
    _, model = compose_at_home(Blueprint(rig, studio), locations)
    np.testing.assert_allclose(model.body("arm2_arm").pos + model.body("arm").pos, 0, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("first_id: 226", "first_id: 225"), "share the marker ids 225..225"),
        (("prefix: arm2_", "prefix: ''"), "same prefix ''"),
        (("side: left", "side: right"), "same side 'right'"),
        (("name: arm2\n", "name: arm1\n"), "same name 'arm1'"),
        (("margin: 0.7", "margin: 0"), "margin 0.0 is not valid"),
        (
            ("position_mm: [175.23, -19.6, -4.1]", "position_mm: [175.23, -19.6, -4.1]\n      quat: [1, 1, 0, 0]"),
            "does not lie flat",
        ),
    ],
)
def test_loading_refuses_a_rig_that_cannot_be(change: tuple[str, str], message: str, locations: Locations) -> None:
    text = locations.find_data_file("configs/rigs/bimanual.yaml").read_text()
    assert change[0] in text
    with pytest.raises(ConfigError, match=message):
        parse_config(RigConfig, "name: mine\n" + text.replace(*change), "mine.yaml", locations)


def test_output_in_the_way_is_kept(locations: Locations, studio: SceneConfig, tmp_path: Path) -> None:
    spec, model = compose_at_home(Blueprint(_rig("single", locations), studio), locations)
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene" / "mine.txt").write_text("keep me")
    with pytest.raises(UsageError, match="--overwrite"):
        write_scene(spec, model, tmp_path / "scene", as_zip=False, overwrite=False)
    report = write_scene(spec, model, tmp_path / "scene", as_zip=False, overwrite=True)
    assert report.moved_aside is not None
    assert (report.moved_aside / "mine.txt").read_text() == "keep me"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scene", "scene.old-1"]


@pytest.mark.parametrize("as_zip", [False, True])
def test_an_old_scene_stays_where_it_is_until_the_new_one_is_on_the_disk(
    as_zip: bool, locations: Locations, studio: SceneConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec, model = compose_at_home(Blueprint(_rig("single", locations), studio), locations)
    old = tmp_path / ("scene.zip" if as_zip else "scene")
    write_scene(spec, model, old, as_zip=as_zip, overwrite=False)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(ResourceError, match="No space left on device"):
        write_scene(spec, model, old, as_zip=as_zip, overwrite=True)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    assert [path.name for path in tmp_path.iterdir()] == [old.name]


@pytest.mark.parametrize(
    ("name", "grasp"),
    [*((name, grasp) for name in (*RIGS, "single_linear") for grasp in (None, "weld")), ("single_linear", "contact")],
)
def test_the_arms_rest_in_keyframe_home(
    name: str, grasp: str | None, make_config: Callable[..., RecordConfig], locations: Locations, studio: SceneConfig
) -> None:
    if grasp is None:
        _, model = compose_at_home(Blueprint(_rig(name, locations), studio), locations)
        start = (0.0, 1.047, 1.047, 0.0, 0.0, 0.0)
    else:
        config = make_config({("rig",): name, ("grasp",): grasp})
        _, model = _task(config, locations)
        start = config.task.start_joints
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    for arm in _rig(name, locations).arms:
        joints = [data.joint(arm.prefix + joint).qpos[0] for joint in arm.robot.joint_names]
        np.testing.assert_array_equal(joints, start)
    held = [arm.prefix + joint for arm in _rig(name, locations).arms for joint in arm.robot.joint_names]
    before = np.array([data.joint(joint).qpos[0] for joint in held])
    mujoco.mj_step(model, data, 500)
    after = np.array([data.joint(joint).qpos[0] for joint in held])
    # rad; without compensation for its camera, the drives of single_linear would sag by 5e-3
    assert np.abs(after - before).max() < 1e-6


def test_a_scene_held_by_friction_steps_as_its_recording_does(
    make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    config = make_config({("rig",): "single_linear", ("grasp",): "contact"})
    recorded = build_scene(Session(config, locations)).model.opt
    _, model = _task(config, locations)
    for field in (name for name in dir(recorded) if not name.startswith("_")):
        np.testing.assert_array_equal(getattr(model.opt, field), getattr(recorded, field), err_msg=field)
    assert model.opt.impratio == 10
