"""Errors of invalid tasks name file, line and key."""

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
from yamsim_cli.core.dataset.upgrade import upgrade_config
from yamsim_cli.core.errors import ConfigError, UsageError
from yamsim_cli.core.expert.planning.arm_solvers import start_postures
from yamsim_cli.core.files.documents.yaml_document import dump_yaml
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.program_checks import check_task_config
from yamsim_cli.session_opener import SessionOpener

PICK: dict[str, Any] = {"pick": {"thing": "cube"}}
LIFT = {"lift": {"thing": "cube"}}

HALF = {"of": "plate", "position": [0, 0.05, 0], "size": [0.1, 0.05, 0.05]}
CUP_OF_PASTA = {"of": "kitchen_measuring_cup", "filled": {"of": "kitchen_dry_pasta", "grams": 150}}
WEIGHED = {"container": "cube", "pieces_of": "plate"}
SCOOPED = {"tool": "cube", "source": "plate", "into": "cube", "grams": 10, "tolerance": 5}

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
        "must have a place for each of cube, plate; wrong: 'cube'",
    ),
    "sizes of what has no shape": (
        {("things", "cube"): {"of": ["cube_red", "011_banana"], "sizes": [1.0, 1.2]}},
        "things.cube.sizes[1]",
        "the banana has no `shape`, so its size is fixed",
    ),
    "sizes that cannot be made": (
        {("things", "plate"): {"of": "kitchen_plate", "sizes": [8]}},
        "things.plate.sizes[0]",
        "the plate cannot be scaled by 8: vessel.diameter_mm: ",
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
        "no hand holds the cube at this step; pick it first",
    ),
    "no hand left": (
        {
            ("rig",): "yam_station_linear_4310_d405",
            ("things", "third"): {"of": "cube_green"},
            ("starts", "third"): {"x": [0.3, 0.4], "y": [0, 0.1]},
            ("expert",): [PICK, {"pick": {"thing": "plate"}}, {"lift": {"thing": "third"}}],
        },
        "expert[2].lift",
        "no hand is free for the third; put the cube and the plate down",
    ),
    "no such part": (
        {("expert",): [{"operate": {"thing": "cube", "joint": "lid", "to": 1}}]},
        "expert[0].operate.joint",
        "the cube_red has no part 'lid' with a handle; valid: (none)",
    ),
    "folded where points do not meet": (
        {
            ("things", "cube"): {"of": "soft_dish_towel"},
            ("expert",): [{"fold": {"thing": "cube", "how": "diagonal"}}],
        },
        "expert[0].fold.how",
        "along a diagonal: that needs equally many points along both sides, not 9 x 13",
    ),
    "folded to no size": (
        {("expert",): [{"fold_small": {"thing": "cube"}}]},
        "expert[0].fold_small",
        "give either `area` or `share`",
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
    "no start": ({("starts", "cube"): None}, "starts", "the cube has no start region"),
    "start of nobody": ({("starts", "cap"): {"x": [0, 1], "y": [0, 1]}}, "starts.cap", "unknown role 'cap'"),
    "on what comes later": (
        {("starts", "plate", "on"): "cube"},
        "starts.plate.on",
        "'cube' is not listed before",
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
        "has a clause and its opposite",
    ),
    "in a hand and in none": (
        {("goal",): {"all": [{"on": {"thing": "cube", "surface": "plate"}}, {"handed_over": {"thing": "cube"}}]}},
        "goal.all[1].handed_over",
        "one clause needs the cube in a hand and another in no hand",
    ),
    "held out and said": (
        {("phrasings", "held_out"): ["the cube goes onto the plate"]},
        "phrasings.held_out",
        "is also in `training`",
    ),
    "several things by one name": (
        {("things", "cube"): {"of": ["cube_red", "cube_blue"], "count": 2, "named": "object"}},
        "things.cube.named",
        "`named: object` needs a role of one object, but this role has 2",
    ),
    "two roles by one name": (
        {
            ("things", "cube", "named"): "object",
            ("things", "plate"): {"of": ["kitchen_plate", "cube_blue"], "named": "object"},
        },
        "things.cube.named",
        "the cube and the plate can both have the name 'cube_blue'",
    ),
    "the name of another role": (
        {
            ("things", "cube", "named"): "object",
            ("things", "cube_red"): {"of": "cube_green"},
            ("starts", "cube_red"): {"x": [0.3, 0.4], "y": [0, 0.1]},
        },
        "things.cube.named",
        "the cube and the cube_red can both have the name 'cube_red'",
    ),
    "from an arm on a thing": (
        {("starts", "cube"): {"on": "plate", "from_arm": "first", "x": [0, 0.1], "y": [0, 0]}},
        "starts.cube.from_arm",
        "a region on the plate is in the frame of the plate, not of an arm",
    ),
    "unknown placeholder": (
        {("phrasings", "held_out"): ["serve the {cub}"]},
        "phrasings.held_out[0]",
        "unknown placeholder {cub}; valid: {cube}, {cube.preposition}, {first_arm}, {plate}, ",
    ),
    "unknown placeholder in the name": (
        {("language_task",): "put_{thing}"},
        "language_task",
        "unknown placeholder {thing}; valid: {cube}, ",
    ),
    "second of one arm": (
        {("arms",): "one", ("expert",): [{"pick": {"thing": "cube", "arm": "second"}}]},
        "expert[0].pick.arm",
        "no second arm does this task",
    ),
    "handed over by one arm": (
        {("arms",): "one", ("expert",): [PICK, {"handover": {"thing": "cube"}}]},
        "expert[1].handover",
        "the step `handover` needs two arms; use a rig with two arms, without `arms: one`",
    ),
    "put onto what carries nothing": (
        {("things", "plate"): {"of": "013_apple"}},
        "expert[1].place.on",
        "target 'apple' has neither a floor nor a flat top to put something on",
    ),
    "a region of nobody": ({("regions",): {"half": {**HALF, "of": "cap"}}}, "regions.half.of", "unknown role 'cap'"),
    "a region with an object's name": (
        {("regions",): {"cube_red": HALF}, ("things", "cube", "named"): "object"},
        "regions.cube_red",
        "'cube_red' is the name of an object too; rename the region",
    ),
    "a region of several objects": (
        {("things", "plate", "count"): 2, ("regions",): {"half": HALF}},
        "regions.half.of",
        "several objects have the role plate; give one of plate_1, plate_2",
    ),
    "a region of an object of several sizes": (
        {("things", "plate"): {"of": "kitchen_plate", "sizes": [1.0, 1.2]}, ("regions",): {"half": HALF}},
        "regions.half.of",
        "the plate has `sizes`, but a region has one size",
    ),
    "an object taken for a region": (
        {("regions",): {"half": HALF}, ("expert",): [PICK, {"place": {"thing": "cube", "on": "half"}}]},
        "expert[1].place.on",
        "`on` cannot be the region half; give a role of objects",
    ),
    "a region in a hand": (
        {("regions",): {"half": HALF}, ("goal",): {"held_by": {"thing": "half"}}},
        "goal.held_by.thing",
        "`thing` cannot be the region half",
    ),
    "a table in a hand": (
        {("expert",): [{"pick": {"thing": "table"}}]},
        "expert[0].pick.thing",
        "`thing` cannot be the table",
    ),
    "a table as a container": (
        {("goal",): {"in": {"thing": "cube", "container": "table"}}},
        "goal.in.container",
        "`container` cannot be the table",
    ),
    "weighed where nothing is loose": (
        {("goal",): {"contains": {"container": "plate", "pieces_of": "cube", "least_g": 5}}},
        "goal.contains.pieces_of",
        "the cube has no loose pieces; add `filled`",
    ),
    "more than there is": (
        {("things", "plate"): CUP_OF_PASTA, ("goal",): {"contains": {**WEIGHED, "least_g": 151}}},
        "goal.contains.least_g",
        "151 g are more than the 150 g of pieces",
    ),
    "poured from nothing": (
        {("expert",): [{"pour": {"thing": "cube", "into": "plate"}}]},
        "expert[0].pour.thing",
        "the cube has no loose pieces",
    ),
    "poured onto a cube": (
        {("things", "plate"): CUP_OF_PASTA, ("expert",): [{"pour": {"thing": "plate", "into": "cube"}}]},
        "expert[0].pour.into",
        "the cube_red is not suitable; give an object whose `shape` has the family vessel",
    ),
    "scooped out of a cup": (
        {("things", "plate"): CUP_OF_PASTA, ("expert",): [{"scoop": SCOOPED}]},
        "expert[0].scoop.source",
        "the measuring_cup is not suitable; give an object whose `shape` has the family container",
    ),
    "sorted into no region": (
        {("expert",): [{"sort": {"into": {"cube": "plate"}}}]},
        "expert[0].sort.into",
        "'plate' is not a region of the task; regions: (none)",
    ),
    "a lid of what has none": (
        {("expert",): [{"open_lid": {"thing": "cube"}}]},
        "expert[0].open_lid.thing",
        "the cube_red has no handle at which a hand could steady it",
    ),
    "opened by one arm": (
        {("arms",): "one", ("expert",): [{"open_lid": {"thing": "cube"}}]},
        "expert[0].open_lid",
        "the step `open_lid` needs two arms",
    ),
    "near miss of nobody": (
        {("near_misses",): [{"thing": "cap", "what": "off"}]},
        "near_misses[0].thing",
        "unknown role 'cap'",
    ),
}


def _load(file: Path, locations: Locations) -> object:
    return load_config(ProgramTask, "tasks", str(file), locations, check=check_task_config)


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
        ConfigError, match=r"small.yaml:\d+: task.starts.cube.x: the whole region of the cube is out of reach"
    ):
        session_of(tmp_path, far)


def test_a_place_out_of_reach_is_told(tmp_path: Path) -> None:
    far = changed({("expert",): [PICK, {"place": {"thing": "cube", "on": "table", "at": [1.5, -0.1]}}]})
    with pytest.raises(ConfigError, match=r"expert\[1\].place.at: \[1.5, -0.1\] is out of reach: it is 1.50 m from"):
        session_of(tmp_path, far)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "key", "said"),
    [
        (
            {("goal",): {"on": {"thing": "cube", "surface": "table"}}},
            "task.goal",
            "the goal holds already at the start, in each of 20 samples; none of the first 3 attempts of seed 0 has",
        ),
        (
            {("starts", "cube", "x"): [0.40, 0.40], ("starts", "cube", "y"): [-0.15, -0.15]},
            "task.starts.cube",
            "no free place for the cube in its start region",
        ),
    ],
)
def test_a_task_without_a_start_is_told_when_it_is_opened(
    changes: dict[tuple[str, ...], Any], key: str, said: str, tmp_path: Path
) -> None:
    file = written(tmp_path, changed(changes))
    opener = SessionOpener(os.environ, lambda text: None, "--{}".format)
    with pytest.raises(ConfigError) as caught:
        opener.open("default", renders=False, task=str(file))
    text = str(caught.value)
    assert re.match(rf"{re.escape(str(file))}:\d+: {re.escape(key)}: {re.escape(said)}", text), text


def test_a_good_task_is_loaded_and_read_back(tmp_path: Path, locations: Locations) -> None:
    session = session_of(tmp_path, changed({}))
    assert session.config.rig.name == "single_linear" and session.config.grasp == "contact"
    text = dump_yaml(session.config.data_config())
    again = parse_config(RecordConfig, text, "config.yaml", locations, upgrade=upgrade_config)
    assert isinstance(again.task, ProgramTask)
    assert again.data_config() == session.config.data_config()


ONE_ARM: dict[str, Any] = changed(
    {
        ("arms",): "one",
        ("things",): {
            "object": {"of": ["cube_red", "cube_blue"], "named": "object"},
            "target": {"of": "kitchen_plate", "named": "object"},
        },
        ("starts",): {
            "target": {"from_arm": "second", "x": [0.38, 0.42], "y": [-0.16, -0.14]},
            "object": {"from_arm": "first", "x": [0.32, 0.38], "y": [0.10, 0.14]},
        },
        ("phrasings",): {"training": ["by the {first_arm}, not the {second_arm}: {object} {target.preposition} it"]},
        ("language_task",): "put_{object}",
        ("goal",): {"all": [{"on": {"thing": "object", "surface": "target", "radius": 0.05}}]},
        ("expert",): [
            {"pick": {"thing": "object", "arm": "first"}},
            {"place": {"thing": "object", "on": "target"}},
        ],
    }
)


def test_a_thing_may_have_the_name_of_its_object(tmp_path: Path) -> None:
    task = session_of(tmp_path, ONE_ARM).config.task
    cast = task.assign_roles({"object": (1,), "target": (0,)})
    assert dict(cast.objects_by_role) == {"object": ("cube_blue",), "target": ("plate",)}
    assert dict(cast.config_names) == {"cube_blue": "cube_blue", "plate": "plate"}
    assert task.possible_names("object") == ("cube_red", "cube_blue")
    assert [item.name for item in task.with_objects_of(cast).objects] == ["cube_blue", "plate"]


@pytest.mark.parametrize(("arm", "other"), [("right", "left"), ("left", "right")])
def test_of_two_arms_one_may_act(arm: str, other: str, tmp_path: Path) -> None:
    config = session_of(tmp_path, ONE_ARM, rig="yam_station_linear_4310_d405", arm=arm).config
    assert [one.side for one in config.acting_arms] == [arm]
    assert (config.rig.arms[config.first_arm].side, config.rig.arms[config.second_arm].side) == (arm, other)
    place = config.rig.arm_origin_y(config.first_arm)
    assert config.start_regions_in_world["object"].y == pytest.approx((0.10 + place, 0.14 + place))
    assert config.start_regions_in_world["target"].y == pytest.approx((-0.16 - place, -0.14 - place))
    assert all(start.from_arm is None for start in config.start_regions_in_world.values())
    acting = config.acting_scene_arms[0]
    assert [stand.opening > 0 for stand in start_postures(config)] == [k == acting for k in range(2)]


def test_on_one_arm_first_and_second_are_the_same(tmp_path: Path) -> None:
    config = session_of(tmp_path, ONE_ARM).config
    assert config.first_arm == config.second_arm == 0
    assert config.start_regions_in_world["target"].y == (-0.16, -0.14)


def test_an_instruction_names_the_objects_and_arms_of_the_attempt(tmp_path: Path) -> None:
    config = session_of(tmp_path, ONE_ARM, rig="yam_station_linear_4310_d405", arm="left").config
    assert config.task.language_prompt == "by the left, not the right: cube red on it"
    played = config.task.with_objects_of(config.task.assign_roles({"object": (1,), "target": (0,)}))
    assert played.phrasings.training == ("by the left, not the right: cube blue on it",)
    assert played.language_task == "put_cube_blue"


def test_an_arm_that_does_not_act_cannot_be_named(tmp_path: Path) -> None:
    left = changed({("expert",): [{"pick": {"thing": "object", "arm": "left"}}]}, ONE_ARM)
    with pytest.raises(ConfigError, match=r"expert\[0\].pick.arm: no left arm does this task, only the right one"):
        session_of(tmp_path, left)
    assert session_of(tmp_path, left, rig="yam_station_linear_4310_d405", arm="left").config.arm == "left"


def test_the_first_grasp_of_a_task_is_its_own(tmp_path: Path) -> None:
    both = changed({("grasps",): ["weld", "contact"]})
    assert session_of(tmp_path, both).config.grasp == "weld"
    assert session_of(tmp_path, both, rig="single").config.grasp == "weld"
    assert session_of(tmp_path, both, grasp="contact").config.grasp == "contact"
    with pytest.raises(UsageError, match="--grasp: task 'small' does not support grasp 'weld'; give contact"):
        session_of(tmp_path, changed({}), grasp="weld")
    with pytest.raises(UsageError, match=r"^--rig: "):
        session_of(tmp_path, changed({}), rig="single")


def test_a_weld_needs_fingers_that_open_wide_enough(tmp_path: Path) -> None:
    wide = changed(
        {("grasps",): ["weld"], ("things", "cube", "of"): ["cube_red", "054_softball"], ("phrasings", "held_out"): []}
    )
    with pytest.raises(UsageError, match=r"^--task: object 'softball'"):
        session_of(tmp_path, wide)
    # Every skill that takes an object takes it by a weld, not only `pick`.
    lifted = changed({("grasps",): ["weld"], ("things", "cube", "of"): "024_bowl", ("expert",): [LIFT]})
    with pytest.raises(UsageError, match=r"^--task: object 'bowl' has no `grasp`"):
        session_of(tmp_path, lifted, rig="yam_station_linear_4310_d405")


def test_flags_reach_into_a_task_with_their_roles(tmp_path: Path) -> None:
    given = {"object": "cube_green", "target": "bin", "threshold": 0.03}
    task = session_of(tmp_path, ONE_ARM, **given).config.task
    assert task.target_predicate is not None
    assert [item.name for item in task.objects] == ["cube_green", "bin"]
    assert task.target_predicate.radius == 0.03
    with pytest.raises(UsageError, match=r"--object: task 'small' has no role 'object'; its roles: plate, cube"):
        session_of(tmp_path, changed({}), object="cube_green")
    with pytest.raises(UsageError, match="--threshold: task 'small' has no `on` with a `radius` in its goal"):
        session_of(tmp_path, changed({}), threshold=0.03)
    with pytest.raises(UsageError, match="--target: target 'apple' has neither a floor nor a flat top"):
        session_of(tmp_path, ONE_ARM, target="013_apple")
    hang = {"hang": {"thing": "object", "onto": "target"}}
    hung = changed({("expert",): [{"pick": {"thing": "object"}}, hang]}, ONE_ARM)
    with pytest.raises(UsageError, match=r"^--object: the cube_green has no handle 'eye'"):
        session_of(tmp_path, hung, object="cube_green")


def test_a_datasets_config_states_defaults_too(tmp_path: Path) -> None:
    task = session_of(tmp_path, changed({})).config.data_config()["task"]
    assert (task["arms"], task["grasps"], task["language_task"]) == ("all", ["contact"], "")
    assert {role["named"] for role in task["things"].values()} == {"role"}
    assert {start["from_arm"] for start in task["starts"].values()} == {None}


@pytest.mark.parametrize("name", Locations.from_environment(os.environ).config_names("tasks"))
def test_every_task_of_ours_is_valid(name: str, locations: Locations) -> None:
    load_config(ProgramTask, "tasks", name, locations, check=check_task_config)
