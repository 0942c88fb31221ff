"""Scenes of KitchenBench as names of tasks, such as `--task kitchenbench/stack/cups`."""

from __future__ import annotations

from typing import Any

from .core.errors import ResourceError

_PREFIX = "kitchenbench/"


def resolve_scene_task(name: str) -> str | dict[str, Any]:
    """The config of a task that is a scene of the benchmark; any other name as it is.

    Raises:
        UsageError: the benchmark has no such scene, or the scene cannot be recorded.
        ResourceError: the benchmark is not installed.
    """
    if not name.startswith(_PREFIX):
        return name
    try:
        from .kitchenbench import scene_tasks as recorded
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in ("inspect_robots", "kitchenbench"):
            raise
        raise ResourceError(
            f"--task {name} needs the package {error.name}, which is not here: pip install 'yamsim[inspect]'"
        ) from error
    return recorded.scene_task_data(name.removeprefix(_PREFIX))
