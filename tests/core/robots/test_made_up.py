"""A robot is files alone: an arm of five joints and a gripper from a user's own folder do what the shipped ones do."""

from __future__ import annotations

import os
import pickle
from pathlib import Path
from typing import Any

import pytest

import yamsim_cli
from tests.cli.run_cli import yamsim
from tests.made_up_robot import ARM, GRIPPER, RIG, write_robot
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.resources import Locations
from yamsim_cli.core.scene.robot import arm_spec


@pytest.fixture
def locations(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Locations:
    """With the robot in a folder of data that the environment names."""
    write_robot(tmp_path / "data")
    monkeypatch.setenv("YAMSIM_DATA_DIR", str(tmp_path / "data"))
    return Locations.find(os.environ)


def report(*words: Any) -> dict[str, Any]:
    done = yamsim(*words, "--json")
    assert done.code == 0, done.err
    return dict(done.json)


@pytest.mark.render
def test_it_is_recorded_and_what_was_recorded_verified(locations: Locations, tmp_path: Path) -> None:
    made = yamsim_cli.record(tmp_path / "made", rig=RIG, grasp="contact", size=(64, 48), quality="fast")
    frame = pickle.loads((made.path / "ep_000000" / "lowdim" / "000000.pkl").read_bytes())
    assert frame["joints"].shape == (6,)  # five joints and the gripper
    assert report("verify", made.path)["agree"] == 1


def test_every_body_is_seen_though_nothing_has_a_mesh(locations: Locations) -> None:
    spec = arm_spec(load_config(RigConfig, "rigs", RIG, locations).arms[0], {})
    seen = {body.name: [geom.group <= 2 for geom in body.geoms] for body in spec.bodies}
    assert all(all(groups) for groups in seen.values())
    assert sum(map(len, seen.values())) == 8


def test_the_gripper_fits_a_shipped_arm_too(locations: Locations) -> None:
    words = ["--rig", f"i2rt_yam+{GRIPPER}", "--grasp", "contact", "--n", 1, "--workers", 1]
    assert report("pickplace", "batch", *words)["n_success"] == 1


def test_robots_list_tells_of_both(locations: Locations) -> None:
    items = {item["name"]: item for item in report("robots", "list")["items"]}
    assert {items[name]["source"] for name in (ARM, GRIPPER)} == {"made up for a test"}
    assert items[ARM]["joints"] == 5
    assert items[ARM]["goes_with"] == [GRIPPER]


@pytest.mark.parametrize(
    "words", [["pickplace", "batch", "--grasp", "contact", "--n", 1], ["render-views", "--out", "views"]]
)
def test_a_gripper_without_pinch_site_is_one_line(locations: Locations, tmp_path: Path, words: list[Any]) -> None:
    (file,) = (tmp_path / "data").glob(f"robot_models/grippers/{GRIPPER}/gripper.xml")
    file.write_text(file.read_text(encoding="utf-8").replace('name="pinch_site"', 'name="pinch"'), encoding="utf-8")
    run = yamsim(*words, "--rig", RIG, cwd=tmp_path)
    assert run.code == 3, run.err
    assert f"{file}: has no site 'pinch_site'; its sites: grasp_site, pinch" in run.message
