from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from yamsim_cli.core.errors import ConfigError
from yamsim_cli.core.motors.wiring import find_wiring
from yamsim_cli.core.resources import Locations


@pytest.mark.parametrize("name", ["yam_v1", "yam_pro_v1", "yam_ultra_v1", "yam_ultra_v2", "big_yam_v1", "i2rt_yam"])
def test_every_arm_says_what_its_motors_are(name: str, locations: Locations) -> None:
    wiring = find_wiring(name, "linear_4310", 6, locations)
    assert wiring.gripper is not None
    # 6.57 rad of the motor for 96 mm between the fingers, and forwards closes them.
    assert wiring.gripper.ratio == pytest.approx(-6.57 / 0.048)
    assert [motor.id for motor in wiring.arm.motors] == [1, 2, 3, 4, 5, 6]


def test_a_gripper_without_wiring_is_told_which_have_one(locations: Locations) -> None:
    with pytest.raises(ConfigError, match=r"linear_3507 has no can.yaml.*crank, crank_4310, finray"):
        find_wiring("yam_v1", "linear_3507", 6, locations)


def test_a_wrong_wiring_is_told_where(locations: Locations, tmp_path: Path) -> None:
    folder = tmp_path / "robot_models" / "yam_v1"
    folder.mkdir(parents=True)
    (folder / "can.yaml").write_text("motors:\n- {id: 1, kind: DM9999}\n")
    with pytest.raises(ConfigError, match=r"can.yaml:2.*unknown motor 'DM9999'; valid: DM3507, DM4310"):
        find_wiring("yam_v1", None, 6, replace(locations, data=(tmp_path, *locations.data)))
    (folder / "can.yaml").write_text("motors:\n- {id: 1, kind: DM4340}\n")
    with pytest.raises(ConfigError, match="has 1 motors, and yam_v1 has 6 joints"):
        find_wiring("yam_v1", None, 6, replace(locations, data=(tmp_path, *locations.data)))
