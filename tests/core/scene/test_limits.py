"""The limits that recorded data is held against are those of the model."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import pytest

from yamsim_cli.core.config.limits import load_limits
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.core.resources import Locations


@pytest.mark.parametrize("gripper", ["crank", "linear_4310"])
def test_ranges_are_the_models(locations: Locations, gripper: str) -> None:
    spec = mujoco.MjSpec.from_file(str(locations.file(f"robot_models/i2rt_yam/yam_{gripper}.xml")))
    joints = {joint.name: tuple(joint.range) for joint in spec.joints}
    limits = load_limits("i2rt_yam", locations)
    assert [joint.name for joint in limits.joints] == [f"joint{k}" for k in range(1, 7)]
    for joint in limits.joints_with(gripper):
        assert joint.range == joints[joint.name]
    assert limits.fingers[gripper] == joints["left_finger"]


def test_an_unknown_gripper_may_move_as_far_as_any(locations: Locations) -> None:
    joints = load_limits("i2rt_yam", locations).joints_with(None)
    assert [joint.range for joint in joints[:4]] == [
        (-2.61799, 3.14159),
        (0, 3.66519),
        (0, 3.66519),
        (-1.69297, 1.5708),
    ]


def test_every_gripper_has_its_limits(locations: Locations) -> None:
    from typing import get_args

    from yamsim_cli.core.config.rig import ArmConfig

    grippers = get_args(ArmConfig.model_fields["gripper"].annotation)
    assert set(load_limits("i2rt_yam", locations).fingers) == set(grippers)


def test_the_drives_are_told_apart_as_in_the_model(locations: Locations) -> None:
    """Joints 1 to 3 have the slow, strong drive. Source: DAMIAO's and I2RT's figures, as in limits.yaml."""
    limits = load_limits("i2rt_yam", locations)
    assert [joint.reported_rad_s for joint in limits.joints] == [10] * 3 + [30] * 3
    assert limits.joints[0].motor_rad_s == pytest.approx(52.5 / 60 * 2 * math.pi)
    for joint in limits.joints:
        assert joint.motor_rad_s < joint.reported_rad_s


def test_an_unknown_model_is_a_missing_resource(tmp_path: Path) -> None:
    with pytest.raises(ResourceError, match=r"robot_models/none/limits\.yaml"):
        load_limits("none", Locations(data=(tmp_path,), assets=tmp_path))
