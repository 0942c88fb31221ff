"""A value in another unit is refused with the probable remedy; recorded values stay valid."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import BaseModel

from yamsim_cli.core.config.loader import CONFIG_KINDS, load_config, parse_config, validate_file
from yamsim_cli.core.config.objects.primitives import Box, Capsule, Cylinder, HullPart, Ring, SdfPart, Sphere
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.dataset.upgrade import upgrade_config
from yamsim_cli.core.errors import ConfigError, UsageError
from yamsim_cli.core.files.documents.config_base import Config
from yamsim_cli.core.files.documents.units import QuantityBounds
from yamsim_cli.core.files.documents.yaml_document import dump_yaml
from yamsim_cli.core.files.resources import Locations

Replace = Callable[[str, str, str], str]

# kind/name, original text, text in another unit, and expected message.
SLIPS = [
    ("tasks/pickplace", "x: [0.30, 0.55]", "x: [300, 550]", ("starts.object.x[0]: 300", "in mm? Then give 0.3")),
    ("tasks/pickplace", "x: [0.30, 0.55]", "x: [30, 55]", ("starts.object.x[0]: 30", "in cm? Then give 0.3")),
    ("tasks/pickplace", "apart: 0.01", "apart: 10", ("starts.object.apart: 10", "in mm? Then give 0.01")),
    ("tasks/pickplace", "[-90, 90]", "[-1.5708, 1.5708]", ("a small range", "in radians? Then give [-90, 90]")),
    ("tasks/pickplace", "[-90, 90]", "[-3.14, 3.14]", ("a small range", "in radians? Then give [-180, 180]")),
    ("tasks/pickplace", "[-90, 90]", "[-1800, 1800]", ("object.yaw_deg[0]: -1800", "-360..360 degrees")),
    ("tasks/pickplace", "starts:", "start_joints: [0, 106, 1, 1, 0, 0]\nstarts:", ("start_joints[1]: 106", "1.85")),
    ("tasks/pickplace", "starts:", "timing: {timestep: 2}\nstarts:", ("timing.timestep: 2", "in ms? Then give 0.002")),
    ("tasks/pickplace", "radius: 0.05", "radius: 50", ("goal.on.radius: 50", "in mm? Then give 0.05")),
    ("tasks/pickplace", "time_limit_s: 20", "time_limit_s: 20000", ("time_limit_s: 20000", "in ms? Then give 20")),
    ("tasks/pickplace", "move: [0, 0.15, 0]", "move: [0, 150, 0]", ("near_misses[0].move[1]: 150", "Then give 0.15")),
    ("rigs/russet", "margin: 0.591", "margin: 591", ("margin: 591", "0..3 m", "in mm? Then give 0.591")),
    ("rigs/russet", "margin: 0.591", "margin: 59.1", ("margin: 59.1", "in cm? Then give 0.591")),
    ("rigs/single", "29.230769", "0.029230769", ("marker_length_mm: 0.029", "in m? Then give 29.23")),
    ("rigs/single", "gap_mm: 2.9230769", "gap_mm: 0.0029230769", ("gap_mm: 0.0029", "in m? Then give 2.923")),
    ("rigs/single", "[175.23, -19.6, -4.1]", "[0.17523, -0.0196, -0.0041]", ("in m? Then give [175.23, -19.6, -4.1]",)),
    ("rigs/single", "[2.41, 225.23]", "[0.00241, 0.22523]", ("x_mm", "in m? Then give [2.41, 225.23]")),
    ("rigs/single", "[0, -0.10, 0.06]", "[0, -100, 60]", ("wrist_camera.position[1]: -100", "in mm? Then give -0.1")),
    ("rigs/single", "fovy_deg: 70", "fovy_deg: 1.2217", ("fovy_deg: 1.2217", "in radians? Then give 70")),
    ("scenes/tabletop", "fovy_deg: 52", "fovy_deg: 1.2", ("fovy_deg: 1.2", "in radians? Then give 68.75")),
    ("scenes/tabletop", "[0.30, 0.35, 0.01]", "[300, 350, 10]", ("half_size[0]: 300", "in mm? Then give 0.3")),
    ("scenes/tabletop", "[1.05, 0.0, 0.85]", "[1050, 0, 850]", ("scene_camera.position[0]: 1050", "give 1.05")),
    ("scenes/tabletop", "safety_plane: -0.5", "safety_plane: -500", ("safety_plane: -500", "in mm? Then give -0.5")),
    ("objects/011_banana", "mass_g: 66", "mass_g: 1e30", ("inertia.mass_g: 1e+30", "0.5..50000 g")),
    ("objects/011_banana", "mass_g: 66", "mass_g: 0.066", ("inertia.mass_g: 0.066", "in kg? Then give 66")),
    ("objects/011_banana", "1.568e-5", "15680", ("diagonal[0]: 15680", "in g mm2? Then give 1.568e-05")),
    ("objects/011_banana", "opening: 0.0165", "opening: 16.5", ("grasp.opening: 16.5", "in mm? Then give 0.0165")),
    ("objects/011_banana", "clearance: 0.010", "clearance: 10", ("grasp.clearance: 10", "in mm? Then give 0.01")),
    ("objects/011_banana", "radius: 0.0181", "radius: 18.1", ("collision[0].radius: 18.1", "give 0.0181")),
    ("objects/011_banana", "[-0.0137, -0.0805, 0.0006]", "[-13.7, -80.5, 0.6]", ("collision[0].start: -13.7",)),
    ("objects/029_plate", "thickness: 0.003", "thickness: 3", ("collision[1].thickness: 3", "in mm? Then give 0.003")),
    ("objects/011_banana", "[-0.0099, 0.0041, 0.0171]", "[-9.9, 4.1, 17.1]", ("mesh.origin[2]: 17.1", "give 0.0171")),
    ("objects/011_banana", "rest_height: 0.0175", "rest_height: 17.5", ("rest_height: 17.5", "give 0.0175")),
    ("objects/011_banana", "force: 15", "force: 15000", ("friction.force: 15000", "0.05..500 N")),
    ("randomization/default", "position: 0.03", "position: 30", ("camera.position: 30", "in mm? Then give 0.03")),
    ("randomization/default", "clearance: 0.03", "clearance: 30", ("distractors.clearance: 30", "give 0.03")),
    ("randomization/default", "x: [0.20, 0.70]", "x: [200, 700]", ("distractors.x[0]: 200", "in mm? Then give 0.2")),
    ("randomization/default", "lens_deg: [-3, 3]", "lens_deg: [-300, 300]", ("lens_deg[0]: -300", "-60..60 degrees")),
    ("randomization/default", "[-0.03, 0.03]", "[-8, 8]", ("brightness[0]: -8", "values of 255? Then give -0.03137")),
]  # fmt: skip


@pytest.mark.parametrize(("config", "old", "new", "parts"), SLIPS, ids=[f"{s[0]} {s[2]}" for s in SLIPS])
def test_a_value_in_another_unit_is_refused_with_the_converted_value(
    tmp_path: Path, locations: Locations, config: str, old: str, new: str, parts: tuple[str, ...]
) -> None:
    kind, name = config.split("/")
    text = locations.config_file(kind, name).read_text()
    assert old in text
    (tmp_path / "mine.yaml").write_text(text.replace(old, new, 1))
    with pytest.raises(ConfigError) as caught:
        validate_file(CONFIG_KINDS[kind], tmp_path / "mine.yaml", locations)
    message = str(caught.value)
    assert re.match(rf"{re.escape(str(tmp_path))}/mine\.yaml:\d+: ", message), message
    assert "\n" not in message
    for part in parts:
        assert part in message


def test_a_flag_in_another_unit_is_a_fault_of_the_command_line(locations: Locations) -> None:
    flags = {("rig",): ("--rig", "russet"), ("rig", "margin"): ("--margin", 591.0)}
    with pytest.raises(UsageError, match=r"^--margin: 591\.0 is not valid: must lie in 0\.\.3 m; is it in mm\? Then g"):
        load_config(RecordConfig, "record", "default", locations, flags)


def test_a_recorded_config_is_not_checked_for_units(
    make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    """A dataset's own config says what it was recorded with, however odd."""
    data = make_config().data_config()
    odd = data | {"task": data["task"] | {"start_joints": [0, 106, 109, -78, 0, 0]}}
    odd["scene"] = data["scene"] | {"scene_camera": data["scene"]["scene_camera"] | {"fovy_deg": 1.2}}
    odd["rig"]["margin"] = 591.0
    odd["task"]["starts"]["object"]["yaw_deg"] = [-1.5708, 1.5708]
    odd["rig"]["arms"][0]["board"]["position_mm"] = [0.1, 0, 0]
    odd["rig"]["arms"][0]["mount"]["x_mm"] = [0.0, 0.2]
    again = parse_config(RecordConfig, dump_yaml(odd), "config.yaml", locations, upgrade=upgrade_config)
    assert again.task.start_joints[1] == 106
    assert again.data_config() == odd
    with pytest.raises(ConfigError, match="is not valid"):
        parse_config(RecordConfig, dump_yaml(odd), "config.yaml", locations)


@pytest.mark.parametrize(("value", "fine"), [((-90, 90), True), ((0, 45), True), ((-1.5708, 1.5708), False),
                                             ((0.0, 0.0), True), ((-2, 2), True), ((0, 6.2832), False)])  # fmt: skip
def test_headings_in_radians_are_told_from_narrow_ones(
    tmp_path: Path, locations: Locations, value: tuple[float, float], fine: bool
) -> None:
    text = locations.config_file("tasks", "pickplace").read_text().replace("[-90, 90]", str(list(value)))
    (tmp_path / "mine.yaml").write_text(text)
    if fine:
        assert validate_file(CONFIG_KINDS["tasks"], tmp_path / "mine.yaml", locations)
    else:
        with pytest.raises(ConfigError, match="radians"):
            validate_file(CONFIG_KINDS["tasks"], tmp_path / "mine.yaml", locations)


def _models(model: type[BaseModel], seen: set[type[BaseModel]]) -> Iterator[type[BaseModel]]:
    if model in seen:
        return
    seen.add(model)
    yield model
    for info in model.model_fields.values():
        for part in _inside(info.annotation):
            if isinstance(part, type) and issubclass(part, BaseModel):
                yield from _models(part, seen)


def _inside(annotation: Any) -> Iterator[Any]:
    yield annotation
    for part in get_args(annotation):
        yield from _inside(part)


# Numbers without a unit, or with bounds of another form.
PLAIN = {
    "rgba", "quat", "x_axis", "y_axis", "direction", "diffuse", "specular", "shininess", "reflectance", "ambient",
    "sky", "axis", "approach",
    "floor_rgba", "friction", "intensity", "tint", "tilt_deg", "rotation_deg", "hue_deg", "saturation", "value",
    "contrast", "colours",
    "salt_pepper", "textures", "mass", "K", "distortion", "focal_sigma", "supersampling", "constants",
    "crumpled", "up", "kinds",
}  # fmt: skip


# Bounded by the object whose parts they are.
PARTS = (Box, Capsule, Cylinder, HullPart, Ring, SdfPart, Sphere)


def test_every_quantity_has_its_bounds() -> None:
    """Each float field has plausible bounds, or is named above."""
    seen: set[type[BaseModel]] = set()
    bare = []
    for kind in CONFIG_KINDS.values():
        for model in _models(kind, seen):
            assert issubclass(model, Config)
            if model in PARTS:
                continue
            for name, info in model.model_fields.items():
                parts = list(_inside(info.annotation))
                numbers = float in parts or info.annotation is float
                marks = [*info.metadata, *(mark for part in parts for mark in getattr(part, "__metadata__", ()))]
                if numbers and not any(isinstance(mark, QuantityBounds) for mark in marks) and name not in PLAIN:
                    bare.append(f"{model.__name__}.{name}")
    assert bare == []


def test_bounds_are_in_the_schema() -> None:
    schema = CONFIG_KINDS["rigs"].model_json_schema()
    margin = schema["properties"]["margin"]
    assert (margin["minimum"], margin["maximum"], margin["description"]) == (0, 3, "in m")
    angle = CONFIG_KINDS["tasks"].model_json_schema()["properties"]["start_joints"]["anyOf"][0]["items"]
    assert angle["maximum"] == pytest.approx(2 * math.pi)
