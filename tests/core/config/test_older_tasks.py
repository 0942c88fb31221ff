"""Tasks as they were written before mean the same as tasks that are data."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from yamsim_cli.core.config.task import TaskConfig

from tests.programs import STATION, written
from yamsim_cli.core.config.loader import load_config, parse_config
from yamsim_cli.core.config.older_tasks import upgrade_task
from yamsim_cli.core.config.program_task import ProgramTask
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.documents.document import dump_yaml, load_yaml
from yamsim_cli.core.errors import ConfigError
from yamsim_cli.core.opener import Opener
from yamsim_cli.core.resources import Locations
from yamsim_cli.core.skills.checked import check_config


def _loaded(folder: Path, task: dict[str, Any], locations: Locations, name: str) -> ProgramTask:
    found: Any = load_config(TaskConfig, "tasks", str(written(folder, task, name)), locations, check=check_config)
    assert isinstance(found, ProgramTask)
    return found


def _shipped(name: str, locations: Locations) -> dict[str, Any]:
    data: dict[str, Any] = load_yaml(locations.config_file("tasks", name)).data
    return data


@pytest.mark.parametrize("name", ["pickplace", "handover"])
def test_the_shipped_tasks_are_those_that_are_data(name: str, tmp_path: Path, locations: Locations) -> None:
    upgraded = _loaded(tmp_path, upgrade_task(_shipped(name, locations)), locations, name)
    ours: Any = load_config(TaskConfig, "tasks", f"{name}_program", locations)
    same = {"name": name, "near_misses": (), "timing": upgraded.timing}
    assert ours.model_copy(update=same).model_dump() == upgraded.model_dump()
    assert upgraded.timing.settle_ticks == 30


@pytest.mark.parametrize(("name", "arm"), [("pickplace", "right"), ("handover", "right"), ("handover", "left")])
def test_a_datasets_own_task_is_read_as_it_was(name: str, arm: str, locations: Locations) -> None:
    opener = Opener(os.environ, lambda text: None, "--{}".format)
    before = opener.config("default", locations, task=name, rig=STATION, arm=arm, threshold=0.03)
    dumped = before.data_config()
    dumped["task"] = upgrade_task(dumped["task"])
    after = parse_config(RecordConfig, dump_yaml(dumped), "config.yaml", locations, as_recorded=True)
    task = after.program
    assert task is not None and task.target_predicate is not None
    assert [item.model_dump() for item in task.objects] == [item.model_dump() for item in before.task.objects]
    assert (task.language_prompt, task.language_task) == (before.task.language_prompt, before.task.language_task)
    assert (task.start_joints, after.grasp, task.target_predicate.radius) == (before.start_joints, before.grasp, 0.03)
    assert task.timing.model_dump() == before.pair.timing.model_dump(exclude={"ticks_per_waypoint", "grip_ticks"})
    assert set(after.acting) == set(before.acting)
    for role, box in (("object", before.object_box), ("target", before.target_box)):
        assert (after.starts[role].x, after.starts[role].y) == (box.x, box.y)
        assert after.starts[role].yaw_deg == getattr(box, f"{role}_yaw_deg")
        assert after.starts[role].apart == box.clearance


def test_words_keep_their_placeholders(locations: Locations) -> None:
    said = upgrade_task(_shipped("handover", locations))["phrasings"]["training"][0]
    assert said == (
        "pick up the {object} with the {first_arm} arm, hand it to the {second_arm} arm and put it "
        "{target.preposition} the {target}"
    )


def test_a_task_that_is_data_stays_as_it_is(locations: Locations) -> None:
    swap = _shipped("swap", locations)
    assert upgrade_task(swap) == swap


def test_a_misspelt_key_is_still_told(tmp_path: Path, locations: Locations) -> None:
    task = upgrade_task(_shipped("pickplace", locations) | {"start_joint": [0.0] * 6})
    with pytest.raises(ConfigError, match="start_joint: unknown key; did you mean 'start_joints'"):
        _loaded(tmp_path, task, locations, "misspelt")
