"""Which tasks there are, and what each one is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..config.loader import load_config
from ..config.program_task import ProgramTask
from ..documents.base import Config
from ..resources import Locations
from ..skills.checked import check_config
from ..skills.program import SKILLS, read_program


def tasks_there(locations: Locations) -> list[dict[str, Any]]:
    """Every task that commands accept by name, JSON-ready, see `task_there`.

    Raises:
        ConfigError: a task's file is not valid.
    """
    return [task_there(name, locations) for name in locations.config_names("tasks")]


def task_there(name: str, locations: Locations) -> dict[str, Any]:
    """What one task is: name, kind, rig, prompt, things, skills, goal, counts, phrasings, starts and so on, and path.

    Raises:
        ConfigError: there is none of that name, or its file is not valid.
    """
    task = load_config(ProgramTask, "tasks", name, locations, check=check_config)
    return _of_program(task) | {"path": str(locations.config_file("tasks", name))}


def _of_program(task: ProgramTask) -> dict[str, Any]:
    names = {kind: name for name, kind in SKILLS.items()}
    program = read_program(task.expert, task.typical_cast)
    return {
        "name": task.name,
        "kind": task.kind,
        "rig": task.rig,
        "prompt": task.language_prompt,
        "things": {role: [item.name for item in one.of] for role, one in task.things.items()},
        "skills": list(dict.fromkeys(names[type(skill)] for skill in program)),
        "goal": list(dict.fromkeys(str(path[-1]) for path, _ in task.goal.predicates())),
        "counts": {role: one.count for role, one in task.things.items()},
        "phrasings": _plain(task.phrasings),
        "starts": {role: _plain(start) for role, start in task.starts.items()},
        "time_limit_s": task.time_limit_s,
        "steps": len(program),
    }


def _plain(config: Config) -> Mapping[str, Any]:
    data: dict[str, Any] = config.model_dump(mode="json")
    return data
