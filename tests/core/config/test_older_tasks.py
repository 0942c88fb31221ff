"""Older files and datasets with tasks of the kinds `pickplace` and `handover` are read as tasks of skills."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.programs import STATION, written
from yamsim_cli.core.config.loader import load_config, parse_config
from yamsim_cli.core.config.program_task import ProgramTask
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.task_migration import upgrade_task
from yamsim_cli.core.dataset.upgrade import upgrade_config
from yamsim_cli.core.errors import ConfigError
from yamsim_cli.core.files.documents.yaml_document import dump_yaml, load_yaml
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.program_checks import check_task_config

TIMING = {"physics_steps_per_tick": 16, "timestep": 0.002, "ticks_per_frame": 2}

# `pickplace` as shipped with version 1 of the engine.
PICKPLACE: dict[str, Any] = {
    "kind": "pickplace",
    "object": "011_banana",
    "target": "029_plate",
    "language_task": "pick_place_{object}",
    "language_prompt": "pick up the {object} and put it {preposition} the {target}",
    "sampling": {
        "x": [0.30, 0.55],
        "y": [-0.18, 0.18],
        "object_yaw_deg": [-90, 90],
        "target_yaw_deg": [-180, 180],
        "min_separation": 0.15,
        "clearance": 0.01,
    },
    "heights": {"approach": 0.06, "lift": 0.07, "arc": 0.09, "release": 0.012},
    "timing": {"ticks_per_waypoint": 12, "grip_ticks": 8, "settle_ticks": 30, **TIMING},
    "success": {"threshold": 0.05, "max_height": 0.10, "max_speed": 0.05},
}

# `handover`, likewise.
HANDOVER: dict[str, Any] = PICKPLACE | {
    "kind": "handover",
    "language_task": "hand_over_{object}",
    "language_prompt": (
        "pick up the {object} with the {giving} arm, hand it to the {taking} arm and put it {preposition} the {target}"
    ),
    "timing": {"ticks_per_waypoint": 12, "settle_ticks": 30, **TIMING},
    "exchange": {
        "object": "banana",
        "x": 0.25,
        "height": 0.10,
        "points": [
            {"position": [-0.0131, -0.045, 0.010], "axis_deg": -1.1, "opening": 0.0165},
            {"position": [0.0125, 0.0407, 0.010], "axis_deg": -39.4, "opening": 0.0165},
        ],
        "clear": 0.08,
        "carry_ticks": 36,
        "take_ticks": 12,
        "both_ticks": 8,
    },
}

OLDER = {"pickplace": PICKPLACE, "handover": HANDOVER}


def _loaded(folder: Path, task: dict[str, Any], locations: Locations, name: str) -> ProgramTask:
    return load_config(ProgramTask, "tasks", str(written(folder, task, name)), locations, check=check_task_config)


def _shipped(name: str, locations: Locations) -> dict[str, Any]:
    data: dict[str, Any] = load_yaml(locations.config_file("tasks", name)).data
    return data


@pytest.mark.parametrize("name", OLDER)
def test_an_older_shipped_task_equals_the_current_one(name: str, tmp_path: Path, locations: Locations) -> None:
    older = _loaded(tmp_path, OLDER[name], locations, name)
    ours = load_config(ProgramTask, "tasks", name, locations)
    assert ours.model_copy(update={"near_misses": (), "timing": older.timing}).model_dump() == older.model_dump()
    assert older.timing.settle_ticks == 30


@pytest.mark.parametrize(("name", "arm"), [("pickplace", "right"), ("handover", "right"), ("handover", "left")])
def test_a_datasets_own_task_is_read_as_it_was(name: str, arm: str, locations: Locations) -> None:
    """A dataset's config states its objects and instruction in full."""
    overrides = {("task",): ("test", name), ("rig",): ("test", STATION), ("arm",): ("test", arm)}
    now = load_config(RecordConfig, "record", "default", locations, overrides)
    words = {role: now.task.things[role].of[0] for role in ("object", "target")}
    older = OLDER[name]
    recorded = now.data_config()
    recorded["task"] = older | {
        "name": name,
        **{role: item.model_dump(mode="json") for role, item in words.items()},
        "language_task": older["language_task"].format(object="banana"),
        "language_prompt": now.task.language_prompt,
        "success": older["success"] | {"threshold": 0.03},
        "start_joints": [0.0, 1.0, 1.0, 0.0, 0.0, 0.0],
    }
    read = parse_config(RecordConfig, dump_yaml(recorded), "config.yaml", locations, upgrade=upgrade_config)
    task = read.task
    assert task.target_predicate is not None
    assert [item.model_dump() for item in task.objects] == [item.model_dump() for item in words.values()]
    assert task.language_prompt == now.task.language_prompt
    assert task.with_objects_of(task.typical_roles).language_task == older["language_task"].format(object="banana")
    assert (task.start_joints, read.grasp) == ((0.0, 1.0, 1.0, 0.0, 0.0, 0.0), "weld")
    assert (task.target_predicate.radius, task.timing.settle_ticks) == (0.03, 30)
    assert (read.acting_indices, read.start_regions_in_world) == (now.acting_indices, now.start_regions_in_world)


def test_a_task_that_is_data_stays_as_it_is(locations: Locations) -> None:
    swap = _shipped("swap", locations)
    assert upgrade_task(swap) == swap


def test_a_misspelt_key_is_still_told(tmp_path: Path, locations: Locations) -> None:
    with pytest.raises(ConfigError, match="start_joint: unknown key; did you mean 'start_joints'"):
        _loaded(tmp_path, PICKPLACE | {"start_joint": [0.0] * 6}, locations, "misspelt")
