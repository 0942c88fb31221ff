"""`yamsim tasks`, and errors of commands that take a task."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.run_cli import yamsim
from tests.programs import changed, written


def test_tasks_are_listed_and_shown() -> None:
    run = yamsim("tasks", "list", "--json")
    assert run.code == 0, run.err
    assert {"pickplace", "handover", "tower"} <= {item["name"] for item in run.json["items"]}
    run = yamsim("tasks", "show", "tower", "--json")
    assert run.code == 0, run.err
    (item,) = run.json["items"]
    assert item["rig"] == "yam_station_linear_4310_d405" and item["phrasings"]["held_out"]


def test_a_bad_task_is_told_before_anything_runs(tmp_path: Path) -> None:
    file = written(tmp_path, changed({("expert",): [{"place": {"thing": "cube", "on": "plate"}}]}))
    for command in (("tasks", "check"), ("record", "--out", tmp_path / "out", "--task"), ("config", "validate")):
        kind = ("--kind", "tasks") if command[0] == "config" else ()
        run = yamsim(*command, file, *kind)
        assert run.code == 3
        assert run.message.startswith(f"{file}:") and "expert[0].place" in run.message
    assert not (tmp_path / "out").exists()


def test_errors_name_the_argument_and_no_flag_that_the_command_does_not_have() -> None:
    run = yamsim("tasks", "check", "towr")
    assert (run.code, run.message[:49]) == (3, "NAME: task: unknown task 'towr'; did you mean 'to")
    for command in ("show", "check"):
        run = yamsim("tasks", command, "abc/put_bottles")
        assert (run.code, run.message[:48]) == (2, "task abc/put_bottles: only `yamsim eval` runs it")


@pytest.mark.slow
def test_picking_and_placing_passes_its_check() -> None:
    run = yamsim("tasks", "check", "pickplace", "--n", "3", "--json")
    assert run.code == 0, run.err
    assert run.json["ok"] and run.json["success_rate"] == 1


def test_a_scene_is_composed_as_a_task_begins(tmp_path: Path) -> None:
    run = yamsim("compose-xml", "--task", "drawer", "--out", tmp_path / "x", "--json")
    assert run.code == 0, run.err
    assert {"cabinet", "cabinet_drawer", "cube", "arm2_arm"} <= set(run.json["bodies"])


def test_a_new_task_is_valid_and_overwrites_nothing(tmp_path: Path) -> None:
    run = yamsim("tasks", "new", "my_task", "--folder", tmp_path, "--json")
    assert run.code == 0, run.err
    file = tmp_path / "my_task.yaml"
    assert run.json == {"path": str(file)}
    assert yamsim("config", "validate", file, "--kind", "tasks").code == 0
    file.write_text("mine")
    run = yamsim("tasks", "new", "my_task", "--folder", tmp_path)
    assert run.code == 2 and "exists and is not overwritten" in run.message and file.read_text() == "mine"
    assert yamsim("tasks", "new", "../my_task", "--folder", tmp_path).code == 2


@pytest.mark.slow
def test_a_new_task_passes_its_check(tmp_path: Path) -> None:
    assert yamsim("tasks", "new", "my_task", "--folder", tmp_path).code == 0
    run = yamsim("tasks", "check", tmp_path / "my_task.yaml", "--n", "3", "--workers", "1", "--json")
    assert run.code == 0, run.err
    assert all(check["ok"] for check in run.json["checks"])


@pytest.mark.slow
def test_failures_of_a_check_are_filmed(tmp_path: Path) -> None:
    changes = {("goal",): {"held_by": {"thing": "cube"}}}
    file = written(tmp_path, changed(changes))
    films = tmp_path / "films"
    run = yamsim("tasks", "check", file, "--n", "1", "--workers", "1", "--video", films, "--json")
    assert run.code == 5, run.err
    assert [path.name for path in films.iterdir()] == ["trial_000000_goal.mp4"]
    program = next(check for check in run.json["checks"] if check["name"] == "program")
    assert program["ok"] is False and "needs the cube in a hand at the end" in program["detail"]


def test_pickplace_batch_is_trials_by_another_name() -> None:
    numbers = ("--n", "1", "--seed", "3", "--workers", "1", "--json")
    one, other = yamsim("trials", "--task", "pickplace", *numbers), yamsim("pickplace", "batch", *numbers)
    assert one.code == other.code == 0
    assert one.json["trials"] == other.json["trials"]
    assert one.json["task"] == "pickplace"
