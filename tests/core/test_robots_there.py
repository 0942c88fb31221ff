"""What `yamsim robots` tells."""

from __future__ import annotations

import pytest

from yamsim_cli.core.errors import UsageError
from yamsim_cli.core.resources import Locations
from yamsim_cli.core.robots_there import robot_there, robots_there


def test_arms_grippers_and_stations_are_listed_with_what_goes_together(locations: Locations) -> None:
    items = {item["name"]: item for item in robots_there(locations)}
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
    assert robot_there("yam_ultra", locations)["name"] == "yam_ultra_v2"
    with pytest.raises(UsageError, match="unknown robot 'yamu'; did you mean"):
        robot_there("yamu", locations)
