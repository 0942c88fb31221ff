from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..core.config.loader import load_config
from ..core.config.program_task import ProgramTask
from ..core.errors import UsageError
from ..core.expert.skills.program import build_program, skill_name
from ..core.files.documents.config_base import Config
from ..core.files.resources import Locations
from ..core.files.writing import describe_refusal, write_file
from ..program_checks import check_task_config

_VALID_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")

_TEMPLATE = """\
# The task {name}. To check it: `yamsim tasks check {name}.yaml`. To record it: `yamsim record --task {name}.yaml`.
kind: program
# The rig without the flag --rig. `yamsim config list` and `yamsim robots list` print other rigs and robots.
rig: yam_station_linear_4310_d405

# Role -> possible objects, of which one is sampled for each attempt. With `count: 2`, two objects have the role.
things:
  plate: {{of: kitchen_plate}}
  cube: {{of: [cube_red, cube_green, cube_blue]}}

# Role -> region of the starts, in `world`: x ahead of the arms, y to the left, m; headings in degrees.
starts:
  plate: {{x: [0.34, 0.42], y: [-0.20, -0.10]}}
  cube: {{x: [0.28, 0.42], y: [0.06, 0.20], yaw_deg: [-45, 45]}}

# Instructions. Each recorded episode has one of `training`. Recordings never use `held_out`.
phrasings:
  training: [put the cube onto the plate, place the cube on the plate]
  held_out: [the cube belongs on the plate]

# Condition of success: predicates, combined by `all`, `any` and `not`. `for_s` is the hold time at the end, s.
goal:
  all:
    - {{on: {{thing: cube, surface: plate}}}}
  for_s: 0.5

# Displacements (x, y and z, m) that turn a success into a failure, for `yamsim tasks check`.
near_misses:
  - {{thing: cube, what: in the air, move: [0, 0, 0.05]}}

# The skills of the expert, in order. `yamsim tasks show NAME` shows the skills of other tasks.
expert:
  - pick: {{thing: cube}}
  - place: {{thing: cube, on: plate}}
"""


def task_entries(locations: Locations) -> list[dict[str, Any]]:
    """Return the descriptions of all tasks that commands accept by name, as JSON data."""
    return [task_entry(name, locations) for name in locations.config_names("tasks")]


def task_entry(name: str, locations: Locations) -> dict[str, Any]:
    """Return `describe_task` of a task by its name or the path of its file, with that path."""
    task = load_config(ProgramTask, "tasks", name, locations, check=check_task_config)
    return {**describe_task(task), "path": str(locations.config_file("tasks", name))}


def describe_task(task: ProgramTask) -> dict[str, Any]:
    """Return the description of a task as JSON data: name, kind, rig, prompt, things, skills, goal, starts etc."""
    program = build_program(task, task.typical_roles)
    return {
        "name": task.name,
        "kind": task.kind,
        "rig": task.rig,
        "prompt": task.language_prompt,
        "things": {role: [item.name for item in one.of] for role, one in task.things.items()},
        "skills": list(dict.fromkeys(skill_name(skill) for skill in program)),
        "goal": list(dict.fromkeys(str(path[-1]) for path, _ in task.goal.predicates())),
        "counts": {role: one.count for role, one in task.things.items()},
        "phrasings": _as_data(task.phrasings),
        "starts": {role: _as_data(start) for role, start in task.starts.items()},
        "time_limit_s": task.time_limit_s,
        "steps": len(program),
    }


def _as_data(config: Config) -> Mapping[str, Any]:
    data: dict[str, Any] = config.model_dump(mode="json")
    return data


def write_task_template(name: str, folder: Path) -> Path:
    """Write the template of a task, and return its file."""
    if not _VALID_NAME.fullmatch(name):
        raise UsageError(
            f"{name!r} is not a valid name for a task; use letters, digits and underscores, and begin with a letter"
        )
    path = folder / f"{name}.yaml"
    if path.exists():
        raise UsageError(f"{path} exists and is not overwritten; give another name, or remove it")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_file(path, _TEMPLATE.format(name=name).encode())
    except OSError as error:
        raise UsageError(describe_refusal(error, path)) from error
    return path
