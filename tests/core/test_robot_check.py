"""Skeletons of arms, and the check of an arm."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from yamsim_cli.core.errors import SimulationError, UsageError
from yamsim_cli.core.resources import Locations
from yamsim_cli.core.robot_check import check_robot, new_robot, require_checked


def test_a_new_arm_passes_its_check_and_overwrites_nothing(tmp_path: Path, locations: Locations) -> None:
    mine = replace(locations, data=(tmp_path, *locations.data))
    model, mjcf = new_robot("my_arm", tmp_path, mine)
    (found,) = check_robot("my_arm", mine)
    assert found["ok"] and found["gripper"] == "linear_4310" and found["sag_rad"] < 0.02
    require_checked("my_arm", [found])
    for taken in ("my_arm", "yam_v1", "../my_arm"):
        with pytest.raises(UsageError, match=r"is not overwritten|is no name"):
            new_robot(taken, tmp_path, mine)
    assert {path.name for path in model.parent.iterdir()} == {"model.yaml", "arm.xml"}
    mjcf.write_text(mjcf.read_text().replace('kp="80"', 'kp="1"').replace('gravcomp="1"', ""))
    with pytest.raises(SimulationError, match=r"arm 'my_arm' with linear_4310: joint. is .* rad off home"):
        require_checked("my_arm", check_robot("my_arm", mine))


def test_a_shipped_arm_passes(locations: Locations) -> None:
    found = check_robot("yam_v1", locations)
    require_checked("yam_v1", found)
    assert sum(one["ok"] is True for one in found) >= 2
