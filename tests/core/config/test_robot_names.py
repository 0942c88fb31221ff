"""Rigs by the names of a robot and a gripper, families and revisions."""

from __future__ import annotations

import pytest

from yamsim_cli.core.config.loader import REVISION, load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.robot_names import families, model_named, revised
from yamsim_cli.core.errors import ConfigError, UsageError
from yamsim_cli.core.resources import Locations


def _rig(name: str, locations: Locations, revision: str | None = None) -> RigConfig:
    overrides = {} if revision is None else {(REVISION,): ("--revision", revision)}
    return load_config(RigConfig, "rigs", name, locations, overrides)


def test_a_family_means_its_newest_revision(locations: Locations) -> None:
    assert list(families(locations)) == ["big_yam", "yam", "yam_pro", "yam_ultra"]
    assert model_named("yam_ultra", locations) == "yam_ultra_v2"
    assert model_named("yam", locations) == "yam_v1"
    assert model_named("i2rt_yam", locations) == "i2rt_yam"
    assert revised("yam_v1", "menagerie", locations) == "i2rt_yam"


@pytest.mark.parametrize(
    ("name", "model", "gripper"),
    [
        ("yam_pro+linear_4310", "yam_pro_v1", "linear_4310"),
        ("yam_ultra_v1+crank_4310", "yam_ultra_v1", "crank_4310"),
        ("big_yam+flexible_4310", "big_yam_v1", "flexible_4310"),
    ],
)
def test_a_robot_and_a_gripper_are_a_rig(name: str, model: str, gripper: str, locations: Locations) -> None:
    (arm,) = _rig(name, locations).arms
    assert (arm.model.name, arm.gripper.name, arm.prefix) == (model, gripper, "")


def test_a_revision_is_put_in_for_every_arm(locations: Locations) -> None:
    assert _rig("yam+linear_4310", locations, "menagerie").arms[0].model.name == "i2rt_yam"
    station = _rig("yam_station_linear_4310_d405", locations, "menagerie")
    assert [arm.model.name for arm in station.arms] == ["i2rt_yam"] * 2


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("yamm+linear_4310", "unknown robot 'yamm'; did you mean 'yam'"),
        ("yam+linear_431", "unknown gripper 'linear_431'; did you mean 'linear_4310'"),
        ("i2rt_yam+flexible_4310", "gripper 'flexible_4310' does not fit 'i2rt_yam'; that carries: crank, linear_4310"),
    ],
)
def test_what_does_not_go_together_is_told_in_one_line(name: str, told: str, locations: Locations) -> None:
    with pytest.raises(ConfigError, match=told) as caught:
        _rig(name, locations)
    assert "\n" not in str(caught.value)


def test_an_unknown_revision_lists_those_there_are(locations: Locations) -> None:
    with pytest.raises(UsageError, match="--revision: yam has no revision 'v7'; valid: menagerie, v1"):
        _rig("yam+linear_4310", locations, "v7")
