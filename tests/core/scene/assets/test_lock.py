import copy
import os.path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.objects.object_config import ObjectConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import ConfigError, ResourceError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.scene.assets import load_lock
from yamsim_cli.core.scene.assets.asset_lock import is_contained
from yamsim_cli.core.scene.blueprint import recording_blueprint
from yamsim_cli.core.scene.compose import rig_mesh_sets, visual_mesh_sets
from yamsim_cli.session_opener import SessionOpener


@pytest.fixture(scope="module")
def committed():
    return load_lock(Locations.from_environment({}))


def test_the_committed_lock_has_the_sets_the_models_name(committed):
    assert {name: len(assets.files) for name, assets in committed.sets.items()} == {
        "finray": 8,
        "i2rt_yam_crank": 17,
        "i2rt_yam_linear_4310": 4,
        "i2rt_arm_yam": 6,
        "i2rt_arm_yam_ultra": 6,
        "i2rt_arm_big_yam": 6,
        "i2rt_gripper_crank_4310": 4,
        "i2rt_gripper_flexible_4310": 3,
        "i2rt_station_cameras": 2,
        "ycb": 2,
        "ycb_small": 6,
        "ycb_objects": 18,
    }


def test_the_committed_lock_is_of_binary_stl_sizes(committed):
    # Source: the binary STL format: an 80-byte header, a 4-byte count, 50 bytes a triangle.
    for assets in committed.sets.values():
        assert all((file.size - 84) % 50 == 0 for file in assets.files.values())


def test_the_committed_notices_carry_what_the_licenses_ask_for(committed):
    for assets in committed.sets.values():
        text = committed.notices[assets.notice]
        if assets.license == "MIT":
            assert ("the yamsim authors" if assets.archive is None else "I2RT Robotics") in text
            assert "shall be included in all" in text
        else:
            assert assets.license == "CC-BY-4.0"
            assert "Calli" in text
            assert "Changes:" in text


def test_nothing_committed_names_a_host():
    for root in Locations.from_environment({}).data:
        for path in (root / "assets").rglob("*"):
            if path.suffix in {".json", ".txt"}:
                assert "://" not in path.read_text()


def test_a_changed_lock_means_another_folder(world):
    before = world.lock.sets["tiny"].directory_name
    raw = copy.deepcopy(world.raw)
    raw["sets"]["tiny"]["files"]["tip.stl"]["sha256"] = "0" * 64
    world.write_lock(raw)
    assert world.lock.sets["tiny"].directory_name != before


@pytest.mark.parametrize(
    ("path", "value", "named"),
    [
        (("sets", "tiny", "files", "tip.stl", "sha256"), "ABC", "sets.tiny.files.tip.stl.sha256"),
        (("sets", "tiny", "files", "tip.stl", "size"), "9", "sets.tiny.files.tip.stl.size"),
        (("sets", "tiny", "files", "tip.stl", "member"), "../../etc/passwd", "'..'"),
        (("sets", "tiny", "files", "../tip.stl"), {"sha256": "0" * 64, "size": 1, "member": "x"}, "../tip.stl"),
        (("sets", "tiny", "archive"), "tinny-meshes", "did you mean 'tiny-meshes'"),
        (("sets", "tiny", "name"), "huge", "has the name 'huge'"),
        (("sets", "tiny", "color"), "red", "color"),
        (("sets", "tiny", "notice"), "../../../etc/passwd", "sets.tiny.notice"),
        (("sets", "tiny", "notice"), ["tiny.txt"], "notice"),
        (("version",), 2, "version"),
    ],
)
def test_an_invalid_lock_is_refused_with_its_file_and_key(world, path, value, named):
    raw = copy.deepcopy(world.raw)
    entry = raw
    for key in path[:-1]:
        entry = entry[key]
    entry[path[-1]] = value
    world.write_lock(raw)
    with pytest.raises(ConfigError) as caught:
        load_lock(world.locations)
    assert "assets.lock.json" in str(caught.value)
    assert named in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["[]", "{", '{"sets": []}', "\xff"])
def test_a_lock_that_is_no_lock_is_refused(world, text):
    (world.locations.data[0] / "assets/assets.lock.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(ConfigError, match=r"assets\.lock\.json"):
        load_lock(world.locations)


def test_a_missing_notice_is_named(world):
    (world.locations.data[0] / "assets/notices/tiny.txt").unlink()
    with pytest.raises(ResourceError, match=r"notices/tiny\.txt"):
        load_lock(world.locations)


@pytest.mark.slow
def test_without_names_all_is_fetched_that_a_shipped_rig_task_or_thing_shows(committed):
    where = Locations.from_environment({})
    opener = SessionOpener({}, lambda text: None, str)
    rigs = {name: load_config(RigConfig, "rigs", name, where) for name in where.config_names("rigs")}
    things = {name: load_config(ObjectConfig, "objects", name, where) for name in where.config_names("objects")}
    # Older tasks name no rig, and `handover` needs two arms.
    given = {name: {"rig": "bimanual"} if name == "handover" else {} for name in where.config_names("tasks")}
    tasks = {name: opener.load_record_config("default", where, task=name, **more) for name, more in given.items()}
    shown = {f"rigs/{name}": rig_mesh_sets(rig) for name, rig in rigs.items()}
    shown |= {f"objects/{name}": item.mesh_sets for name, item in things.items()}
    shown |= {f"tasks/{name}": visual_mesh_sets(recording_blueprint(config)) for name, config in tasks.items()}
    fetched = {assets.name for assets in committed.select_sets([])}
    assert {place: lacks for place, names in shown.items() if (lacks := set(names) - fetched)} == {}
    on_demand = {"i2rt_arm_yam_ultra", "i2rt_arm_big_yam", "i2rt_gripper_flexible_4310"}
    assert fetched == committed.sets.keys() - on_demand
    assert sum(committed.sets[name].total_bytes for name in fetched) < 40e6
    assert [assets.name for assets in committed.select_sets(["i2rt_arm_big_yam"])] == ["i2rt_arm_big_yam"]


@given(st.text(alphabet="a./", max_size=12))
def test_a_contained_path_stays_inside(path):
    if is_contained(path):
        assert os.path.normpath(f"/root/{path}").startswith("/root")
