from __future__ import annotations

from typing import Any

from .core.errors import ResourceError, UsageError

ABC_TASK = "abc/put_bottles"  # task of ABC's simulated evaluation, in its own scene
_PREFIX = "kitchenbench/"


def resolve_scene_task(name: str) -> str | dict[str, Any]:
    """Return the config of a task that is a KitchenBench scene, and any other name unchanged.

    Raises:
        UsageError: the task is ABC's, which only `yamsim eval` runs.
        ResourceError: KitchenBench is not installed.
    """
    if name == ABC_TASK:
        raise UsageError(f"task {name}: only `yamsim eval` runs it, as its scene is not built from yamsim's configs")
    if not name.startswith(_PREFIX):
        return name
    try:
        from .kitchenbench import scene_tasks as recorded
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in ("inspect_robots", "kitchenbench"):
            raise
        raise ResourceError(
            f"task {name} needs the package {error.name}, which is missing: pip install 'yamsim[inspect]'"
        ) from error
    return recorded.scene_task_data(name.removeprefix(_PREFIX))
