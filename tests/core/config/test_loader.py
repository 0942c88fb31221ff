from typing import Any

import pytest

from yamsim_cli.core.config.loader import (
    CONFIG_KINDS,
    REVISION_KEY,
    config_model,
    load_config,
    parse_config,
    validate_file,
)
from yamsim_cli.core.config.objects.object_config import ObjectConfig
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.robot_families import find_families, other_revision, resolve_model_name
from yamsim_cli.core.errors import ConfigError, UsageError, YamsimError
from yamsim_cli.core.files.documents.yaml_document import dump_yaml
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.program_checks import check_task_config

SHIPPED = [(kind, name) for kind in CONFIG_KINDS for name in Locations.from_environment({}).config_names(kind)]
# Robots are files beside each other, recorded by name.
BY_NAME = ("robots", "grippers")

# Key paths of `--object`, `--target` and `--threshold` in a pickplace recording.
OBJECT, TARGET = (("task", "things", role, "of") for role in ("object", "target"))
RADIUS = ("task", "goal", "on", "radius")

PUCK = """\
mesh: {set: ycb, file: puck.stl, origin: [0, 0, 0], rgba: [1, 1, 1, 1]}
inertia: {mass_g: 10, diagonal: [1e-5, 1e-5, 1e-5], quat: [1, 0, 0, 0]}
collision:
  - {type: cylinder, centre: [0, 0, 0.01], radius: 0.02, half_height: 0.01}
rest_height: 0
"""


def refusal(load, *arguments: Any, kind: type[YamsimError] = ConfigError, **options: Any) -> str:
    with pytest.raises(kind) as caught:
        load(*arguments, **options)
    message = str(caught.value)
    assert type(caught.value) is kind
    assert "\n" not in message
    return message


@pytest.fixture
def puck(tmp_path, locations):
    """Check the puck with one line replaced."""

    def check(old: str = "", new: str = "") -> ObjectConfig:
        assert old in PUCK
        path = tmp_path / "puck.yaml"
        path.write_text(PUCK.replace(old, new))
        return validate_file(ObjectConfig, path, locations)

    return check


@pytest.fixture
def record(tmp_path, locations):
    """Load the default recording with lines replaced, and with overrides."""

    def load(replaced: dict[str, str] | None = None, overrides: dict | None = None) -> RecordConfig:
        text = locations.config_file("record", "default").read_text()
        for old, new in (replaced or {}).items():
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "mine.yaml"
        path.write_text(text)
        return load_config(RecordConfig, "record", str(path), locations, overrides, check_task_config)

    return load


@pytest.mark.parametrize(("kind", "name"), SHIPPED)
def test_every_shipped_config_is_valid_and_survives_being_written_down(kind, name, locations):
    model = config_model(kind)
    config = load_config(model, kind, name, locations)
    if kind not in BY_NAME:
        again = parse_config(model, dump_yaml(config.model_dump(mode="json")), "resolved.yaml", locations)
        assert again == config


def test_a_datasets_own_config_needs_no_other_file_but_its_robots(config, locations, repository, tmp_path):
    text = dump_yaml(config.data_config())
    (tmp_path / "robot_models").symlink_to(repository / "robot_models")
    nowhere = Locations(data=(tmp_path,), assets=locations.assets)
    again = parse_config(RecordConfig, text, "config.yaml", nowhere)
    assert again.data_config() == config.data_config()
    assert "episodes" not in text
    assert "workers" not in text


def test_an_unknown_kind_is_named_with_the_valid_ones():
    message = refusal(config_model, "rig")
    assert message.startswith("unknown kind of config 'rig'; did you mean 'rigs'?")
    assert all(kind in message for kind in CONFIG_KINDS)


def test_a_config_is_named_after_its_file_unless_it_says_otherwise(puck):
    assert puck().name == "puck"
    assert puck("rest_height: 0", "rest_height: 0\nname: disc").name == "disc"


def test_an_invalid_file_name_is_refused_as_a_name(tmp_path, locations):
    (tmp_path / "my-puck.yaml").write_text(PUCK)
    message = refusal(validate_file, ObjectConfig, tmp_path / "my-puck.yaml", locations)
    assert "my-puck.yaml:1: name: 'my-puck' is not valid" in message


def test_an_unknown_key_names_file_line_valid_keys_and_the_closest(puck, tmp_path):
    message = refusal(puck, "rest_height: 0", "rest_hieght: 0")
    assert message.startswith(
        f"{tmp_path / 'puck.yaml'}:5: rest_hieght: unknown key; did you mean 'rest_height'? valid: "
    )
    assert "collision, contact, grasp, handles, inertia" in message
    assert message.endswith("(and 1 more)")


def test_an_unknown_key_inside_names_the_keys_valid_there(puck):
    message = refusal(puck, "mass_g: 10", "mass_g: 10, masss: 3")
    assert (
        "puck.yaml:2: inertia.masss: unknown key; did you mean 'mass_g'? valid: centre, diagonal, mass_g, quat"
        in message
    )


def test_an_unknown_key_of_a_list_item_has_the_items_number_in_its_path(puck):
    message = refusal(puck, "half_height: 0.01", "half_height: 0.01, radus: 2")
    assert "puck.yaml:4: collision[0].radus: unknown key; did you mean 'radius'?" in message


@pytest.mark.parametrize(
    ("old", "new", "start"),
    [
        ("mass_g: 10", "mass_g: -10", "puck.yaml:2: inertia.mass_g: -10 is not valid: must lie in 0.5..50000 g"),
        ("mass_g: 10", "mass_g: heavy", "puck.yaml:2: inertia.mass_g: 'heavy' is not valid: must be a valid number"),
        ("radius: 0.02", "radius: 0", "puck.yaml:4: collision[0].radius: 0 is not valid: must be greater than 0"),
        ("rest_height: 0", "rest_height:", "puck.yaml:5: rest_height: None is not valid: must be a valid number"),
        (
            "[1, 1, 1, 1]",
            "[1, 2, 1, 1]",
            "puck.yaml:1: mesh.rgba: [1, 2, 1, 1] is not valid: each part must lie in 0..1",
        ),
        ("quat: [1, 0, 0, 0]", "quat: [0, 0, 0, 0]", "puck.yaml:2: inertia.quat: [0, 0, 0, 0] is not valid: a zero"),
        ("rest_height: 0", "rest_height: .inf", "puck.yaml:5: rest_height: inf is not valid: must be a finite number"),
        (
            "origin: [0, 0, 0]",
            "origin: [0, .nan, 0]",
            "puck.yaml:1: mesh.origin[1]: nan is not valid: must be a finite",
        ),
        ("origin: [0, 0, 0]", "origin: [0, 0]", "puck.yaml:1: mesh.origin: has 2 values; give [x, y, z]"),
        (
            "rest_height: 0",
            "rest_height: 0\ncontact: 5",
            "puck.yaml:6: contact: 5 is not valid: must be a valid dictionary",
        ),
    ],
)
def test_a_wrong_value_names_file_line_key_and_value(puck, tmp_path, old, new, start):
    assert refusal(puck, old, new).startswith(f"{tmp_path}/{start}")


def test_a_missing_key_is_named_with_the_place_it_should_stand_in(puck):
    assert "puck.yaml:2: inertia.mass_g: missing; add it" in refusal(puck, "mass_g: 10, ", "")
    assert "puck.yaml:1: rest_height: " in refusal(puck, "rest_height: 0\n", "")
    assert "puck.yaml:4: collision[0].radius: " in refusal(puck, "radius: 0.02, ", "")


def test_an_unknown_branch_of_a_union_names_the_valid_ones(puck):
    message = refusal(puck, "type: cylinder", "type: cone")
    assert "puck.yaml:4: collision[0]: " in message
    assert "'cone'" in message
    assert all(f"'{branch}'" in message for branch in ("capsule", "cylinder", "ring"))


def test_the_branch_is_no_part_of_the_key_path(puck):
    message = refusal(puck, "centre: [0, 0, 0.01]", "centre: [0, 0, high]")
    assert "collision[0].centre[2]: 'high' is not valid" in message
    assert "cylinder" not in message


@pytest.mark.parametrize(("key", "kind"), [("rig", "rig"), ("scene", "scene"), ("task", "task")])
def test_an_unknown_reference_names_where_it_stands_and_what_there_is(record, locations, key, kind):
    known = locations.config_names(f"{kind}s")
    line = next(
        number
        for number, text in enumerate(locations.config_file("record", "default").read_text().splitlines(), start=1)
        if text.startswith(f"{key}:")
    )
    message = refusal(record, {f"{key}: ": f"{key}: x"})
    assert f"mine.yaml:{line}: {key}: unknown {kind} 'x" in message
    assert "did you mean" in message
    assert f"valid: {', '.join(known)}" in message


def test_an_unknown_object_of_a_named_task_is_found_in_the_tasks_file(tmp_path, record, locations):
    text = locations.config_file("tasks", "pickplace").read_text()
    task = tmp_path / "mytask.yaml"
    task.write_text(text.replace("of: 011_banana", "of: 011_bananna"))
    line = text[: text.index("of: 011_banana")].count("\n") + 1
    message = refusal(record, None, {("task",): ("--task", str(task))})
    place = f"{task}:{line}: task.things.object.of"
    assert f"{place}: unknown object '011_bananna'; did you mean '011_banana'? valid: " in message


def test_a_reference_to_a_file_that_is_not_there_is_named(record):
    message = refusal(record, {"rig: single": "rig: nowhere.yaml"})
    assert "mine.yaml:2: rig: rig config file nowhere.yaml does not exist" in message


def test_a_fault_in_a_referenced_file_is_placed_in_that_file(tmp_path, record, locations):
    rig = tmp_path / "mine2.yaml"
    rig.write_text(locations.config_file("rigs", "single").read_text().replace("side: right", "side: middle"))
    message = refusal(record, {"rig: single": f"rig: {rig}"})
    assert message.startswith(f"{rig}:")
    assert "rig.arms[0].side: 'middle' is not valid: must be 'left' or 'right'" in message


@pytest.mark.parametrize("order", [1, -1])
def test_a_flag_reaches_inside_a_reference_even_one_that_a_flag_named(record, locations, tmp_path, order):
    task = tmp_path / "mytask.yaml"
    task.write_text(locations.config_file("tasks", "pickplace").read_text().replace("for_s: 0.25", "for_s: 0.5"))
    flags = [(("task",), ("--task", str(task))), (RADIUS, ("--threshold", 0.123))]
    config = record(None, dict(flags[::order]))
    assert config.task.name == "mytask"
    assert (config.task.target_predicate.radius, config.task.goal.for_s) == (0.123, 0.5)


def test_a_flag_inside_a_reference_may_be_a_reference(record, tmp_path):
    (tmp_path / "puck.yaml").write_text(PUCK)
    config = record(None, {TARGET: ("--target", str(tmp_path / "puck.yaml"))})
    assert [item.name for item in config.task.things["target"].of] == ["puck"]


@pytest.mark.parametrize(
    ("path", "flag", "value", "message"),
    [
        (("episodes",), "--n", 0, "--n: 0 is not valid: must be greater than or equal to 1"),
        (
            ("image", "jpeg_quality"),
            "--jpeg-quality",
            101,
            "--jpeg-quality: 101 is not valid: must be less than or equal",
        ),
        (RADIUS, "--threshold", -1, "--threshold: -1 is not valid: must lie in 0.."),
        (("image", "size_px"), "--size", [8, 480], "--size: 8 is not valid: must be greater than or equal to 16"),
    ],
)
def test_a_bad_flag_is_a_usage_error_that_names_the_flag(record, path, flag, value, message):
    assert refusal(record, None, {path: (flag, value)}, kind=UsageError).startswith(message)


def test_an_unknown_reference_by_flag_names_the_flag(record):
    message = refusal(record, None, {("rig",): ("--rig", "sinlge")}, kind=ConfigError)
    assert message.startswith("--rig: rig: unknown rig 'sinlge'; did you mean 'single'?")


@pytest.mark.parametrize("value", ["5", "", "[1, 2]", "true"])
def test_a_flag_below_something_that_is_no_mapping_leaves_the_file_to_blame(record, value):
    message = refusal(record, {"task: pickplace": f"task: {value}"}, {RADIUS: ("--t", 0.1)})
    assert "mine.yaml:4: task: " in message
    assert "must be a valid dictionary" in message


def test_a_check_across_several_keys_needs_no_value_in_its_message(tmp_path, locations):
    path = tmp_path / "floating.yaml"
    path.write_text(
        locations.config_file("scenes", "tabletop").read_text().replace("safety_plane: -0.5", "safety_plane: 1")
    )
    message = refusal(validate_file, config_model("scenes"), path, locations)
    assert "safety_plane 1.0 m must lie below the table's top" in message
    assert "{" not in message


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ({("arm",): ("--arm", "left")}, "--arm: arm 'left': rig 'single' has only a right arm; leave `arm` out"),
        ({("task",): ("--task", "handover"), ("rig",): ("--rig", "single")},
         "--rig: "),
        ({("grasp",): ("--grasp", "contact")}, "--grasp: "),
        (
            {("rig",): ("--rig", "single_linear"), OBJECT: ("--object", "025_mug"),
             ("grasp",): ("--grasp", "weld"), ("randomization",): ("--randomize", "default")},
            "--object: distractors and the task's objects must all differ: mug, plate",
        ),
        ({OBJECT: ("--object", "024_bowl")}, "--object: object 'bowl' has no `grasp`"),
        ({OBJECT: ("--object", "054_softball")}, "--object: object 'softball'"),
        ({OBJECT: ("--object", "029_plate")}, "--object: the target"),
        ({TARGET: ("--target", "011_banana")}, "--target: the target"),
        ({TARGET: ("--target", "013_apple")}, "--target: target 'apple' has neither a floor"),
    ],
)  # fmt: skip
def test_values_that_do_not_fit_together_blame_the_flag_that_was_given(record, flags, message):
    assert refusal(record, None, flags, kind=UsageError).startswith(message)


def test_values_of_a_file_that_do_not_fit_together_blame_the_likeliest(record, tmp_path):
    message = refusal(record, {"task: pickplace": "task: pickplace\narm: left"})
    assert message.startswith(f"{tmp_path / 'mine.yaml'}:5: arm: ")
    message = refusal(record, {"task: pickplace": "task: pickplace\ngrasp: contact"})
    assert message.startswith(f"{tmp_path / 'mine.yaml'}:5: grasp: ")


@pytest.fixture
def mixed(tmp_path, locations):
    """Two arms, the right one with the gripper with pads, the left one with the crank."""
    text = locations.config_file("rigs", "bimanual").read_text().replace("gripper: crank", "gripper: linear_4310", 1)
    (tmp_path / "mixed.yaml").write_text(text)
    return {("rig",): ("--rig", str(tmp_path / "mixed.yaml"))}


def test_the_gripper_of_an_arm_that_does_nothing_does_not_matter(record, mixed):
    mug = {OBJECT: ("--object", "025_mug")}
    assert [item.name for item in record(None, mixed | mug).task.things["object"].of] == ["mug"]
    assert record(None, mixed | {("grasp",): ("--grasp", "contact")}).grasp == "contact"
    left = {("arm",): ("--arm", "left")}
    message = refusal(record, None, mixed | mug | left, kind=UsageError)
    assert message.startswith("--object: object 'mug' is too wide to be picked up: 83 mm, and gripper crank")
    message = refusal(record, None, mixed | left | {("grasp",): ("--grasp", "contact")}, kind=UsageError)
    assert "and arm2 of rig 'mixed' has crank" in message
    handed = {("task",): ("--task", "handover")}
    assert record(None, mixed | handed).task.name == "handover"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("radius: 0.05", "radius: '0,05'",
         "goal.on.radius: '0,05' is not valid: a number has a decimal point; write 0.05"),
        ("seed: 0", "seed: 1,5", "seed: '1,5' is not valid: a number has a decimal point; write 1.5"),
        ("x: [0.30, 0.55]", "x: 0.4", "starts.object.x: 0.4 is not valid: give [low, high]"),
        ("x: [0.30, 0.55]", "x: [0.4]", "starts.object.x: has 1 value; give [low, high]"),
        ("x: [0.30, 0.55]", "x: [0,30, 0,55]",
         "starts.object.x: has 4 values; give [low, high]; a number has a decimal point, not a comma"),
        ("x: [0.30, 0.55]", "x: [0.1, 0.2, 0.3]", "starts.object.x: has 3 values; give [low, high]"),
        ("x: [0.30, 0.55]", "x: [0.55, 0.30]", "starts.object.x: [0.55, 0.3] is not valid: a range is [low, high]"),
        ("starts:", "start_joints: 0\nstarts:", "start_joints: 0 is not valid: give a list"),
        ("size_px: [640, 480]", "size_px: 640", "image.size_px: 640 is not valid: give a list of 2"),
    ],
)  # fmt: skip
def test_a_wrong_type_is_refused_with_the_expected_form(tmp_path, locations, old, new, message):
    kind = "record" if ("seed" in old or "size" in old) else "tasks"
    text = locations.config_file(kind, "default" if kind == "record" else "pickplace").read_text()
    assert old in text
    (tmp_path / "mine.yaml").write_text(text.replace(old, new, 1))
    found = refusal(validate_file, config_model(kind), tmp_path / "mine.yaml", locations)
    assert f": {message}" in found
    assert "tuple" not in found


@pytest.mark.parametrize("kind", ["randomization", "rigs", "scenes", "objects", "quality", "record", "tasks"])
@pytest.mark.parametrize("wanted", ["tasks", "rigs", "objects", "randomization"])
def test_a_config_of_another_kind_is_recognized(kind, wanted, locations):
    name = {"randomization": "default", "rigs": "single", "scenes": "tabletop", "objects": "011_banana",
            "quality": "fast", "record": "default", "tasks": "pickplace"}[kind]  # fmt: skip
    path = locations.config_file(kind, name)
    if kind == wanted:
        assert load_config(config_model(wanted), wanted, str(path), locations)
    else:
        message = refusal(load_config, config_model(wanted), wanted, str(path), locations)
        assert message.startswith(f"{path}: has keys of the kind {kind!r} (")
        assert message.endswith(f"give a file of the kind {wanted!r}")


def test_a_randomization_given_as_a_task_names_the_flag(record, locations):
    path = str(locations.config_file("randomization", "default"))
    message = refusal(record, None, {("task",): ("--task", path)}, kind=ConfigError)
    text = refusal(load_config, RecordConfig, "record", path, locations, {("seed",): ("--seed", 1)})
    assert text.startswith(f"{path}: has keys of the kind 'randomization' (")
    assert message.startswith(f"--task: task: {path}: has keys of the kind 'randomization'")


def _rig(name: str, locations: Locations, revision: str | None = None) -> RigConfig:
    overrides = {} if revision is None else {(REVISION_KEY,): ("--revision", revision)}
    return load_config(RigConfig, "rigs", name, locations, overrides)


def test_a_family_means_its_newest_revision(locations: Locations) -> None:
    assert {"big_yam", "yam", "yam_pro", "yam_ultra"} <= find_families(locations).keys()
    assert resolve_model_name("yam_ultra", locations) == "yam_ultra_v2"
    assert resolve_model_name("yam", locations) == "yam_v1"
    assert resolve_model_name("i2rt_yam", locations) == "i2rt_yam"
    assert other_revision("yam_v1", "menagerie", locations) == "i2rt_yam"


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
        ("i2rt_yam+flexible_4310", "gripper 'flexible_4310' does not fit 'i2rt_yam'; valid: crank, linear_4310"),
    ],
)
def test_contradicting_values_are_refused_in_one_line(name: str, told: str, locations: Locations) -> None:
    with pytest.raises(ConfigError, match=told) as caught:
        _rig(name, locations)
    assert "\n" not in str(caught.value)


def test_an_unknown_revision_lists_those_there_are(locations: Locations) -> None:
    with pytest.raises(UsageError, match="--revision: yam has no revision 'v7'; valid: menagerie, v1"):
        _rig("yam+linear_4310", locations, "v7")
