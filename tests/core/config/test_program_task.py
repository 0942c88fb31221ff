"""Bad tasks: what is wrong with one is told with its file, line and key."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import pytest

from tests.programs import changed, session_of, written
from yamsim_cli.core.config.loader import load_config, parse_config
from yamsim_cli.core.config.program_task import ProgramTask
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.task import TaskConfig
from yamsim_cli.core.documents.document import dump_yaml
from yamsim_cli.core.errors import ConfigError
from yamsim_cli.core.opener import Opener
from yamsim_cli.core.resources import Locations
from yamsim_cli.core.skills.checked import check_config

PICK: dict[str, Any] = {"pick": {"thing": "cube"}}

BAD = {
    "unknown thing": ({("things", "cube", "of"): ["cube_purple"]}, "things.cube.of[0]", "unknown object 'cube_purple'"),
    "unknown predicate": ({("goal",): {"onto": {"thing": "cube"}}}, "goal.onto", "unknown key; did you mean 'on'?"),
    "no goal": ({("goal",): {}}, "goal", "this one is empty"),
    "unknown role in the goal": (
        {("goal",): {"on": {"thing": "cub", "surface": "plate"}}},
        "goal.on.thing",
        "unknown role 'cub'; did you mean 'cube'?",
    ),
    "unknown role in a list of the goal": (
        {("goal",): {"piled": {"things": ["plate", "cubs"]}}},
        "goal.piled.things",
        "unknown role 'cubs'",
    ),
    "arrangement without a thing": (
        {("arrangements",): [{"seed": 0, "places": {"plate": [0.4, -0.15, 0]}}]},
        "arrangements[0].places",
        "has to give a place to each of cube, plate, and differs in 'cube'",
    ),
    "sizes of what has no shape": (
        {("things", "cube"): {"of": ["cube_red", "011_banana"], "sizes": [1.0, 1.2]}},
        "things.cube.sizes[1]",
        "the banana has no `shape`, and only what is made from its sizes has others",
    ),
    "sizes that cannot be made": (
        {("things", "plate"): {"of": "kitchen_plate", "sizes": [8]}},
        "things.plate.sizes[0]",
        "the plate cannot be made 8 times as large: vessel.diameter_mm: ",
    ),
    "unknown key of a role": ({("things", "cube", "cuont"): 2}, "things.cube.cuont", "did you mean 'count'?"),
    "unknown skill": ({("expert",): [{"pikc": {"thing": "cube"}}]}, "expert[0].pikc", "unknown skill 'pikc'; did you"),
    "unknown role in the program": (
        {("expert",): [{"pick": {"thing": "cubes"}}]},
        "expert[0].pick.thing",
        "did you mean 'cube'",
    ),
    "unknown argument": (
        {("expert",): [{"pick": {"thing": "cube", "hand": "left"}}]},
        "expert[0].pick.hand",
        "unknown key; valid: arm, lift, thing",
    ),
    "placed before it is picked": (
        {("expert",): [{"place": {"thing": "cube", "on": "plate"}}]},
        "expert[0].place",
        "the cube is in no hand here: pick it first",
    ),
    "no hand left": (
        {
            ("rig",): "yam_station_linear_4310_d405",
            ("things", "third"): {"of": "cube_green"},
            ("starts", "third"): {"x": [0.3, 0.4], "y": [0, 0.1]},
            ("expert",): [PICK, {"pick": {"thing": "plate"}}, {"lift": {"thing": "third"}}],
        },
        "expert[2].lift",
        "no hand is free for the third: the cube and the plate is held",
    ),
    "no such part": (
        {("expert",): [{"operate": {"thing": "cube", "joint": "lid", "to": 1}}]},
        "expert[0].operate.joint",
        "the cube_red has no part 'lid' with a handle; valid: (none)",
    ),
    "nothing to hang it by": (
        {("expert",): [PICK, {"hang": {"thing": "cube", "onto": "plate"}}]},
        "expert[1].hang.thing",
        "the cube_red has no handle 'eye'; valid: (none)",
    ),
    "no peg": (
        {("goal",): {"hung": {"thing": "cube", "onto": "plate"}}},
        "goal.hung.thing",
        "the cube_red has no handle 'eye'; valid: (none)",
    ),
    "no start": ({("starts", "cube"): None}, "starts", "nothing says where the cube starts"),
    "start of nobody": ({("starts", "cap"): {"x": [0, 1], "y": [0, 1]}}, "starts.cap", "unknown role 'cap'"),
    "on what comes later": (
        {("starts", "plate", "on"): "cube"},
        "starts.plate.on",
        "'cube' is nothing that is placed before",
    ),
    "opened what has no parts": (
        {("starts", "cube", "open"): {"lid": [0, 1]}},
        "starts.cube.open.lid",
        "has no part 'lid'",
    ),
    "misspelt kind": ({("kind",): "progam"}, "kind", "unknown kind 'progam'; did you mean 'program'? valid: handover,"),
    "misspelt role in starts": (
        {("starts", "cube"): None, ("starts", "cbe"): {"x": [0.3, 0.4], "y": [0, 0.1]}},
        "starts.cbe",
        "unknown role 'cbe'; did you mean 'cube'?",
    ),
    "place in millimetres": (
        {("expert",): [PICK, {"place": {"thing": "cube", "on": "table", "at": [380, -120]}}]},
        "expert[1].place.at[0]",
        "must lie in -2.5..2.5 m; is it in mm? Then give 0.38",
    ),
    "push in millimetres": (
        {("expert",): [{"push": {"thing": "cube", "to": [0.3, -120]}}]},
        "expert[0].push.to[1]",
        "is it in mm? Then give -0.12",
    ),
    "misspelt argument": (
        {("expert",): [{"each": {"of": "cube", "do": [{"pick": {"thign": "it"}}]}}]},
        "expert[0].each.do[0].pick.thign",
        "unknown key; did you mean 'thing'?",
    ),
    "a clause and its opposite": (
        {
            ("goal",): {
                "all": [
                    {"on": {"thing": "cube", "surface": "plate"}},
                    {"not": {"on": {"thing": "cube", "surface": "plate"}}},
                ]
            }
        },
        "goal",
        "asks for a clause and for its opposite",
    ),
    "in a hand and in none": (
        {("goal",): {"all": [{"on": {"thing": "cube", "surface": "plate"}}, {"handed_over": {"thing": "cube"}}]}},
        "goal.all[1].handed_over",
        "one clause needs the cube in a hand and another needs it in none",
    ),
    "held out and said": (
        {("phrasings", "held_out"): ["the cube goes onto the plate"]},
        "phrasings.held_out",
        "so it is not held out",
    ),
    "near miss of nobody": (
        {("near_misses",): [{"thing": "cap", "what": "off"}]},
        "near_misses[0].thing",
        "unknown role 'cap'",
    ),
}


def _load(file: Path, locations: Locations) -> object:
    return load_config(TaskConfig, "tasks", str(file), locations, check=check_config)


@pytest.mark.parametrize("fault", BAD)
def test_a_fault_is_told_with_its_place(fault: str, tmp_path: Path, locations: Locations) -> None:
    changes, key, said = BAD[fault]
    file = written(tmp_path, changed(changes))
    with pytest.raises(ConfigError) as caught:
        _load(file, locations)
    text = str(caught.value)
    assert re.match(rf"{re.escape(str(file))}:\d+: {re.escape(key)}: ", text), text
    assert said in text


def test_the_line_is_that_of_the_key(tmp_path: Path, locations: Locations) -> None:
    file = written(tmp_path, changed({("expert",): [PICK, {"place": {"thing": "cube", "on": "plat"}}]}))
    line = next(
        k for k, text in enumerate(file.read_text().splitlines(), 1) if "plat}" in text or "on: plat\n" in f"{text}\n"
    )
    with pytest.raises(ConfigError, match=rf":{line}: expert\[1\].place.on: unknown role 'plat'; did you mean 'plate'"):
        _load(file, locations)


def test_a_region_out_of_reach_is_told(tmp_path: Path) -> None:
    far = changed({("starts", "cube", "x"): [1.0, 1.2]})
    with pytest.raises(
        ConfigError, match=r"small.yaml:\d+: task.starts.cube.x: all of the region of the cube is out of reach"
    ):
        session_of(tmp_path, far)


def test_a_place_out_of_reach_is_told(tmp_path: Path) -> None:
    far = changed({("expert",): [PICK, {"place": {"thing": "cube", "on": "table", "at": [1.5, -0.1]}}]})
    with pytest.raises(ConfigError, match=r"expert\[1\].place.at: \[1.5, -0.1\] is out of reach: it is 1.50 m from"):
        session_of(tmp_path, far)


@pytest.mark.parametrize(
    ("changes", "key", "said"),
    [
        (
            {("goal",): {"on": {"thing": "cube", "surface": "table"}}},
            "task.goal",
            "the goal holds already at the start, in each of 20 draws; none of the first 3 attempts of seed 0 has",
        ),
        (
            {("starts", "cube", "x"): [0.40, 0.40], ("starts", "cube", "y"): [-0.15, -0.15]},
            "task.starts.cube",
            "no free place for the cube where it is to start; none of the first 3",
        ),
    ],
)
def test_a_task_without_a_start_is_told_when_it_is_opened(
    changes: dict[tuple[str, ...], Any], key: str, said: str, tmp_path: Path
) -> None:
    file = written(tmp_path, changed(changes))
    opener = Opener(os.environ, lambda text: None, "--{}".format)
    with pytest.raises(ConfigError) as caught:
        opener.open("default", renders=False, task=str(file))
    text = str(caught.value)
    assert re.match(rf"{re.escape(str(file))}:\d+: {re.escape(key)}: {re.escape(said)}", text), text


def test_a_good_task_is_loaded_and_read_back(tmp_path: Path, locations: Locations) -> None:
    session = session_of(tmp_path, changed({}))
    assert session.config.rig.name == "single_linear" and session.config.grasp == "contact"
    text = dump_yaml(session.config.data_config())
    again = parse_config(RecordConfig, text, "config.yaml", locations, as_recorded=True)
    assert isinstance(again.task, ProgramTask)
    assert again.data_config() == session.config.data_config()


def test_another_rig_is_taken_where_one_is_named(tmp_path: Path) -> None:
    session = session_of(tmp_path, changed({}), rig="yam_station_linear_4310_d405")
    assert session.config.rig.name == "yam_station_linear_4310_d405"


@pytest.mark.parametrize("name", Locations.find(os.environ).config_names("tasks"))
def test_every_task_of_ours_is_valid(name: str, locations: Locations) -> None:
    load_config(TaskConfig, "tasks", name, locations, check=check_config)
