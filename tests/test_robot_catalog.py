"""Arms, grippers and stations, new arms, and the check of an arm."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from tests.cli.run_cli import yamsim
from yamsim_cli.core.errors import ConfigError, SimulationError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.robot_catalog import check_robot, require_checked, robot_entries, robot_entry, write_robot_template


def test_arms_grippers_and_stations_are_listed_with_what_goes_together(locations: Locations) -> None:
    items = {item["name"]: item for item in robot_entries(locations)}
    assert {item["kind"] for item in items.values()} == {"arm", "gripper", "station"}
    assert "flexible_4310" in items["yam_v1"]["goes_with"]
    assert "flexible_4310" not in items["i2rt_yam"]["goes_with"]
    assert items["yam_ultra_v2"]["newest"]
    assert not items["yam_ultra_v1"]["newest"]
    assert items["no_gripper"]["opens_mm"] == 0
    assert items["yambox_linear_4310_d405_decxin"]["cameras"] == ["top", "left", "right"]
    assert all(item["source"] for item in items.values() if item["kind"] != "station")
    assert set(items["big_yam_v1"]["meshes"]) == {"i2rt_arm_big_yam"}


def test_a_familys_name_shows_its_newest_revision(locations: Locations) -> None:
    assert robot_entry("yam_ultra", locations)["name"] == "yam_ultra_v2"
    with pytest.raises(UsageError, match="unknown robot 'yamu'; did you mean"):
        robot_entry("yamu", locations)


def _copy_of_yam(folder: Path, locations: Locations, changes: dict[str, str]) -> Locations:
    """A copy of yam_v1, called `copy`, with parts of its model.yaml replaced."""
    copied = folder / "robot_models" / "copy"
    shutil.copytree(locations.config_file("robots", "yam_v1").parent, copied)
    text = (copied / "model.yaml").read_text()
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    (copied / "model.yaml").write_text(text)
    return replace(locations, data=(folder, *locations.data))


_OWN_FAMILY = {"family: yam": "family: copy"}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({}, "is revision 'v1' of 'yam' too; give the new one another revision"),
        (_OWN_FAMILY | {"name: joint3": "name: elbow"}, "has no joint 'elbow'; its joints: joint1, "),
        (_OWN_FAMILY | {"flange: link_6": "flange: link_7"}, "has no body 'link_7'; its bodies: arm, link_1, "),
        (_OWN_FAMILY | {"home: [0, ": "home: ["}, "home: has 5 values; give one for each of joint1, "),
    ],
)
def test_the_check_reports_the_arms_own_fault(
    tmp_path: Path, locations: Locations, changes: dict[str, str], message: str
) -> None:
    """The gripper `crank`, which no such arm can have, is not blamed."""
    with pytest.raises(ConfigError, match=re.escape(message)):
        check_robot("copy", _copy_of_yam(tmp_path, locations, changes))


def test_the_check_finds_an_arm_in_the_same_folder_with_the_same_revision(tmp_path: Path, locations: Locations) -> None:
    mine = _copy_of_yam(tmp_path, locations, _OWN_FAMILY)
    shutil.copytree(tmp_path / "robot_models" / "copy", tmp_path / "robot_models" / "a_second_copy")
    for name in ("copy", "a_second_copy"):
        with pytest.raises(ConfigError, match="is revision 'v1' of 'copy' too; give the new one another revision"):
            check_robot(name, mine)


def test_an_arm_without_start_starts_at_home(tmp_path: Path, locations: Locations) -> None:
    mine = _copy_of_yam(tmp_path, locations, _OWN_FAMILY | {"start: [": "# start: ["})
    found = {one["gripper"]: one for one in check_robot("copy", mine)}
    assert found["linear_4310"]["ok"] is True
    assert found["crank"]["ok"] is None and "the gripper crank has no wrist_camera" in found["crank"]["detail"]


def test_the_check_of_a_gripper_names_the_arms_that_carry_it(locations: Locations) -> None:
    with pytest.raises(UsageError, match=r"'linear_3507' is a gripper; check an arm that carries it, .*yam_v1"):
        check_robot("linear_3507", locations)


@pytest.mark.slow
def test_a_users_arm_with_a_shipped_ones_revision_is_at_fault_and_the_rest_is_listed(
    tmp_path: Path, locations: Locations
) -> None:
    mine = replace(locations, data=(tmp_path, *locations.data))
    # Its name comes before and after the shipped one's.
    for name in ("a_copy", "z_copy"):
        path, _ = write_robot_template(name, tmp_path, mine)
        path.write_text(path.read_text() + "family: yam_ultra\nrevision: v2\n")
    items = {item["name"]: item for item in robot_entries(mine)}
    shipped = locations.config_file("robots", "yam_ultra_v2")
    for name in ("a_copy", "z_copy"):
        ours = tmp_path / "robot_models" / name / "model.yaml"
        fault = items[name]["fault"]
        assert fault.startswith(f"{ours}:") and f"{shipped} is revision 'v2' of 'yam_ultra' too" in fault
        with pytest.raises(ConfigError, match="yam_ultra_v2"):
            robot_entry(name, mine)
    assert [name for name, item in items.items() if "fault" in item] == ["a_copy", "z_copy"]
    assert items.keys() - {"a_copy", "z_copy"} == {item["name"] for item in robot_entries(locations)}
    assert robot_entry("yam_ultra", mine)["name"] == "yam_ultra_v2"
    done = yamsim("robots", "list", env={"YAMSIM_DATA_DIR": str(tmp_path)})
    assert done.code == 0
    assert "big_yam" in done.out and "NOT VALID" in done.out
    assert "a_copy is not valid: " in done.err and "z_copy is not valid: " in done.err


def test_an_arm_that_cannot_be_read_does_not_hide_the_others(tmp_path: Path, locations: Locations) -> None:
    mine = replace(locations, data=(tmp_path, *locations.data))
    path = tmp_path / "robot_models" / "mine" / "model.yaml"
    path.parent.mkdir(parents=True)
    path.write_text("base: [\n")
    items = {item["name"]: item for item in robot_entries(mine)}
    assert str(path) in items["mine"]["fault"]
    assert len(items) == len(robot_entries(locations)) + 1


def test_a_new_arm_passes_its_check_and_overwrites_nothing(tmp_path: Path, locations: Locations) -> None:
    mine = replace(locations, data=(tmp_path, *locations.data))
    model, mjcf = write_robot_template("my_arm", tmp_path, mine)
    (found,) = check_robot("my_arm", mine)
    assert found["ok"] and found["gripper"] == "linear_4310" and found["sag_rad"] < 0.02
    require_checked("my_arm", [found])
    for taken in ("my_arm", "yam_v1", "../my_arm"):
        with pytest.raises(UsageError, match=r"is not overwritten|is not a valid name"):
            write_robot_template(taken, tmp_path, mine)
    assert {path.name for path in model.parent.iterdir()} == {"model.yaml", "arm.xml"}
    mjcf.write_text(mjcf.read_text().replace('kp="80"', 'kp="1"').replace('gravcomp="1"', ""))
    with pytest.raises(SimulationError, match=r"arm 'my_arm' with linear_4310: joint. is .* rad off home"):
        require_checked("my_arm", check_robot("my_arm", mine))


def test_a_shipped_arm_passes(locations: Locations) -> None:
    found = check_robot("yam_v1", locations)
    require_checked("yam_v1", found)
    assert sum(one["ok"] is True for one in found) >= 2
