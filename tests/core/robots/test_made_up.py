"""A robot from files alone: an arm of five joints and a gripper from a user's folder behave as shipped ones."""

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
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.scene.arm_model import arm_spec


@pytest.fixture
def locations(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Locations:
    """With the robot in a data folder that the environment names."""
    write_robot(tmp_path / "data")
    monkeypatch.setenv("YAMSIM_DATA_DIR", str(tmp_path / "data"))
    return Locations.from_environment(os.environ)


def report(*words: Any) -> dict[str, Any]:
    done = yamsim(*words, "--json")
    assert done.code == 0, done.err
    return dict(done.json)


@pytest.mark.slow
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


@pytest.mark.slow
def test_the_gripper_fits_a_shipped_arm_too(locations: Locations) -> None:
    words = ["--rig", f"i2rt_yam+{GRIPPER}", "--grasp", "contact", "--n", 1, "--workers", 1]
    assert report("pickplace", "batch", *words)["n_success"] == 1


def test_robots_list_tells_of_both(locations: Locations) -> None:
    items = {item["name"]: item for item in report("robots", "list")["items"]}
    assert {items[name]["source"] for name in (ARM, GRIPPER)} == {"made up for a test"}
    assert items[ARM]["joints"] == 5
    assert items[ARM]["goes_with"] == [GRIPPER]


def broken(locations: Locations, file: str, old: str, new: str) -> Path:
    """A file of the made-up robot with a fault."""
    path = locations.data[0] / "robot_models" / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return path


LOADS = [
    ("robots", "check", ARM),
    ("pickplace", "batch", "--rig", RIG, "--grasp", "contact", "--n", 1, "--workers", 1),
    ("render-views", "--rig", RIG, "--out", "VIEWS"),
]


@pytest.mark.parametrize("words", LOADS, ids=lambda words: words[0])
@pytest.mark.parametrize("site", ["pinch_site", "grasp_site"])
def test_a_gripper_without_its_sites_is_refused_by_its_file(
    locations: Locations, tmp_path: Path, words: tuple[Any, ...], site: str
) -> None:
    path = broken(locations, f"grippers/{GRIPPER}/gripper.xml", f'<site name="{site}" pos="0 0 0.13"/>', "")
    done = yamsim(*(tmp_path / "views" if word == "VIEWS" else word for word in words))
    assert done.code == 3
    assert f"{path}: has no site '{site}'" in done.err
    assert len(done.err.splitlines()) == 1


@pytest.mark.parametrize("words", LOADS, ids=lambda words: words[0])
@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('<joint name="turn"', '<joint name="turn" class="nope"', "XML Error: unknown default class name 'nope' "),
        ('mass="0.3"', 'mass="0"', "mass and inertia of moving bodies must be larger than mjMINVAL "),
    ],
    ids=["not read", "not compiled"],
)
def test_an_arm_that_does_not_compile_is_told_in_one_line(
    locations: Locations,
    tmp_path: Path,
    words: tuple[Any, ...],
    old: str,
    new: str,
    told: str,
) -> None:
    path = broken(locations, f"{ARM}/arm.xml", old, new)
    done = yamsim(*(tmp_path / "views" if word == "VIEWS" else word for word in words))
    assert done.code == 3
    assert str(path) in done.err and told in done.err
    assert len(done.err.splitlines()) == 1
