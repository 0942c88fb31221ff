from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from yamsim_cli.core.errors import UsageError
from yamsim_cli.flags.output_files import RenameExisting, VideoTrials
from yamsim_cli.flags.session_options import ConfigOption, Json, Offline, Rig, Seed, Workers, session_opener
from yamsim_cli.kitchen_scenes import resolve_scene_task
from yamsim_cli.terminal.console import print_json, print_line, print_report, progress_bar
from yamsim_cli.terminal.tables import ItemTable, print_item, print_items
from yamsim_cli.terminal.trial_tables import film_with_progress, open_films

app = typer.Typer(help="List and show tasks, and make and check your own.", no_args_is_help=True)

_CHECK_RESULT_LABELS = {True: "passed", False: "FAILED", None: "does not apply"}


@app.command("list")
def list_tasks(json: Json = False) -> None:
    """List the tasks with their objects, skills and instructions.

    Example: yamsim tasks list
    """
    from yamsim_cli.task_validation.task_catalog import task_entries

    print_items(
        task_entries(session_opener.find_locations()), ["name", "things", "skills", "instruction"], _task_row, json
    )


@app.command()
def show(
    name: Annotated[str, typer.Argument(help="A task's name, a YAML file, or `kitchenbench/TASK/INSTANCE`.")],
    json: Json = False,
) -> None:
    """Show one task: objects by role, their start ranges, instructions, skills and goal.

    Example: yamsim tasks show tower
    """
    from yamsim_cli.core.config.program_task import ProgramTask
    from yamsim_cli.task_validation.task_catalog import describe_task, task_entry

    scene = name if name.endswith((".yaml", ".yml")) else resolve_scene_task(name)
    if isinstance(scene, str):
        print_item(task_entry(name, session_opener.find_locations()), json)
    else:
        print_item(describe_task(ProgramTask.model_validate(scene)), json)


@app.command()
def new(
    name: Annotated[str, typer.Argument(help="The new task's name: letters, digits and underscores.")],
    folder: Annotated[Path, typer.Option("--folder", help="Folder of NAME.yaml.")] = Path(),
    json: Json = False,
) -> None:
    """Write the commented file of a new task that passes `yamsim tasks check`. No file is overwritten.

    Example: yamsim tasks new my_task
    """
    from yamsim_cli.task_validation.task_catalog import write_task_template

    path = write_task_template(name, folder)
    if json:
        print_json({"path": str(path)})
    else:
        print_line(f"{path}: change it, then try it with `yamsim tasks check {path}`.")


@app.command()
def check(
    name: Annotated[str, typer.Argument(help="A task's name or a YAML file.")],
    n: Annotated[int, typer.Option("--n", min=1, help="Attempts of the expert.")] = 20,
    least: Annotated[
        float, typer.Option("--min-success", min=0, max=1, help="Smallest share of attempts that must succeed.")
    ] = 0.85,
    video: Annotated[
        Path | None,
        typer.Option(help="Record videos of failed trials: one FILE.mp4 of all, or a file for each in a folder."),
    ] = None,
    video_trials: VideoTrials = 10,
    overwrite: RenameExisting = False,
    seed: Seed = None,
    workers: Workers = None,
    rig: Rig = None,
    config: ConfigOption = "default",
    offline: Offline = False,
    json: Json = False,
) -> None:
    """Validate a task: its region is in reach, its expert succeeds, and idle attempts and near misses fail.

    The exit code is 3 if its file is not valid, and 5 if a check fails.

    Example: yamsim tasks check tower --n 20
    """
    if overwrite and video is None:
        raise UsageError("--overwrite needs --video; give --video too, or leave --overwrite out")
    # This command's task is an argument, so errors cannot name the flag `--task`.
    opener = replace(
        session_opener,
        setting_label=lambda setting: "NAME" if setting == "task" else session_opener.setting_label(setting),
    )
    session = opener.open(config, renders=video is not None, task=name, n=n, seed=seed, workers=workers, rig=rig)

    from yamsim_cli.task_validation.validation import require_passed, validate_task

    films = open_films(video, session.config, overwrite=overwrite) if video else None
    with progress_bar(f"checking {session.config.task.name}", "attempts") as advance:
        report = validate_task(session, least, advance)
    if films:
        from yamsim_cli.trials import film_trials

        report["videos"] = film_with_progress(
            films, lambda shown: film_trials(report["trials"], video_trials, films, session, shown)
        )
    print_report(report, lambda: _check_table(report), json)
    require_passed(report)


def _check_table(report: Mapping[str, Any]) -> ItemTable:
    table = ItemTable(["check", "", "found"], numbers_from=3)
    for check in report["checks"]:
        table.add_row(check["name"].replace("_", " "), _CHECK_RESULT_LABELS[check["ok"]], check["detail"])
    for trial in report["trials"]:
        table.add_row(f"trial {trial['trial']}", trial["outcome"]["cause"], trial["outcome"]["detail"])
    return table


def _task_row(item: Mapping[str, Any]) -> list[str]:
    return [item["name"], ", ".join(item["things"]), ", ".join(item["skills"]), item["prompt"]]
