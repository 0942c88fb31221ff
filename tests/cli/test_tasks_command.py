"""`yamsim tasks`, and what commands say that know only one of the two kinds of tasks."""

from __future__ import annotations

from pathlib import Path

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
        assert run.message.startswith(f"{file}:") and "the cube is in no hand here: pick it first" in run.message
    assert not (tmp_path / "out").exists()


def test_who_knows_only_one_kind_says_so() -> None:
    run = yamsim("tasks", "check", "pickplace")
    assert run.code == 2 and "`yamsim pickplace batch --task pickplace` counts" in run.message


def test_a_scene_is_composed_as_a_task_begins(tmp_path: Path) -> None:
    run = yamsim("compose-xml", "--task", "drawer", "--out", tmp_path / "x", "--json")
    assert run.code == 0, run.err
    assert {"cabinet", "cabinet_drawer", "cube", "arm2_arm"} <= set(run.json["bodies"])
