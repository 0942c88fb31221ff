from dataclasses import replace
from pathlib import Path

import pytest

from yamsim_cli.core.errors import ConfigError, ResourceError, suggest_similar
from yamsim_cli.core.files.resources import Locations

AN_ARM_TOO = "; or an arm and its gripper, such as yam_pro+linear_4310"


@pytest.fixture
def two_roots(tmp_path) -> Locations:
    for root, names in (("mine", ["single", "odd"]), ("shipped", ["single", "double"])):
        (tmp_path / root / "configs/rigs").mkdir(parents=True)
        for name in names:
            (tmp_path / root / f"configs/rigs/{name}.yaml").write_text(f"# {root}\n")
    return Locations(data=(tmp_path / "mine", tmp_path / "shipped"), assets=tmp_path / "assets")


def test_the_first_root_that_has_a_file_wins(two_roots):
    assert two_roots.config_file("rigs", "single").read_text() == "# mine\n"
    assert two_roots.config_file("rigs", "double").read_text() == "# shipped\n"


def test_the_configs_of_all_roots_are_listed_once(two_roots):
    assert two_roots.config_names("rigs") == ["double", "odd", "single"]
    assert two_roots.config_names("tasks") == []


def test_an_unknown_config_names_the_closest_and_all_valid_ones(two_roots):
    with pytest.raises(ConfigError) as caught:
        two_roots.config_file("rigs", "singel")
    assert str(caught.value) == "unknown rig 'singel'; did you mean 'single'? valid: double, odd, single" + AN_ARM_TOO


@pytest.mark.parametrize("name", ["../rigs/single", "/etc/passwd", "", "rigs/single", "*"])
def test_a_name_never_leads_out_of_its_folder(two_roots, name):
    with pytest.raises(ConfigError, match="valid: double, odd, single;"):
        two_roots.config_file("rigs", name)


@pytest.mark.parametrize("suffix", [".yaml", ".yml"])
def test_a_path_is_taken_as_it_is(two_roots, tmp_path, suffix):
    path = tmp_path / f"my rig{suffix}"
    path.write_text("")
    assert two_roots.config_file("rigs", str(path)) == path


@pytest.mark.parametrize("name", ["nowhere.yaml", "folder.yml"])
def test_a_path_that_is_no_file_is_named(two_roots, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    Path("folder.yml").mkdir()
    with pytest.raises(ConfigError) as caught:
        two_roots.config_file("rigs", name)
    assert str(caught.value) == f"rig config file {name} does not exist"


def test_a_missing_file_names_every_root_and_the_fix(two_roots):
    with pytest.raises(ResourceError) as caught:
        two_roots.find_data_file("robot_models/x.xml")
    message = str(caught.value)
    assert "robot_models/x.xml" in message
    assert all(str(root) in message for root in two_roots.data)
    assert "YAMSIM_DATA_DIR" in message
    assert "\n" not in message


def test_the_shipped_data_is_always_among_the_roots(repository):
    found = Locations.from_environment({"HOME": "/home/someone"})
    assert found.data == (repository,)
    assert found.find_data_file("configs/rigs/single.yaml").is_file()


def test_the_users_own_folder_comes_first():
    assert Locations.from_environment({"HOME": "/h", "YAMSIM_DATA_DIR": "/mine"}).data[0] == Path("/mine")
    assert len(Locations.from_environment({"HOME": "/h", "YAMSIM_DATA_DIR": ""}).data) == 1


@pytest.mark.parametrize(
    ("environment", "assets"),
    [
        ({"HOME": "/h", "XDG_CACHE_HOME": "/c", "YAMSIM_ASSETS": "/a"}, "/a"),
        ({"HOME": "/h", "XDG_CACHE_HOME": "/c"}, "/c/yamsim/assets"),
        ({"HOME": "/h", "XDG_CACHE_HOME": "", "YAMSIM_ASSETS": ""}, "/h/.cache/yamsim/assets"),
    ],
)
def test_meshes_are_kept_where_the_environment_says(environment, assets):
    assert Locations.from_environment(environment).assets == Path(assets)
    assert Locations.from_environment({}).assets == Path.home() / ".cache/yamsim/assets"


@pytest.mark.parametrize(
    ("value", "valid", "text"),
    [
        ("singel", {"single", "bimanual"}, "did you mean 'single'? valid: bimanual, single"),
        ("zzz", ["b", "a"], "valid: a, b"),
        ("x", [], "valid: (none)"),
    ],
)
def test_a_suggestion_lists_what_is_valid(value, valid, text):
    assert suggest_similar(value, valid) == text


@pytest.mark.parametrize("stands_for", ["balanced", "high"])
def test_auto_names_the_quality_that_was_chosen(repository, stands_for):
    found = replace(Locations.from_environment({"HOME": "/h"}), auto_quality=stands_for)
    assert found.config_file("quality", "auto") == repository / f"configs/quality/{stands_for}.yaml"
    assert found.config_names("quality") == ["auto", "balanced", "fast", "high", "photo"]
    assert "auto" not in found.config_names("rigs")
    with pytest.raises(ConfigError, match="valid: bimanual, russet, single"):
        found.config_file("rigs", "auto")
