"""The flags that commands share which run a task, and the config that they make."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .session import locations, parse_size, skip_gl, use_gl

if TYPE_CHECKING:
    from yamsim_cli.core.config.document import KeyPath
    from yamsim_cli.core.config.record import RecordConfig
    from yamsim_cli.core.resources import Locations

ConfigOption = Annotated[
    str,
    typer.Option("--config", metavar="NAME|FILE", help="Record config: a name from configs/record/ or a YAML file."),
]
Rig = Annotated[str | None, typer.Option(help="Rig: a name from configs/rigs/ or a YAML file.")]
Task = Annotated[str | None, typer.Option(help="Task: a name from configs/tasks/ or a YAML file.")]
Object = Annotated[
    str | None,
    typer.Option(
        "--object", metavar="NAME|FILE", help="What is picked up: a name from configs/objects/ or a YAML file."
    ),
]
Target = Annotated[
    str | None, typer.Option(metavar="NAME|FILE", help="Onto or into what it is put, named as the object is.")
]
Grasp = Annotated[
    str | None,
    typer.Option(
        metavar="weld|contact",
        help="What holds the object: a weld that is switched on, or friction alone, which needs a gripper with pads "
        "(--rig single_linear).  [default: weld]",
    ),
]
Arm = Annotated[
    str | None,
    typer.Option(metavar="left|right", help="Which arm of a rig with two does the task.  [default: right]"),
]
Seed = Annotated[int | None, typer.Option(help="Everything random follows from it.")]
Workers = Annotated[int | None, typer.Option(help="Worker processes; they never change the data.")]
Threshold = Annotated[
    float | None, typer.Option(help="Largest distance from the target's centre, m.  [default: the task's, 0.05]")
]
Wrist = Annotated[bool | None, typer.Option("--wrist/--no-wrist", help="Also record the wrist camera.")]
Randomize = Annotated[
    bool | None,
    typer.Option("--randomize/--no-randomize", help="Vary lights, camera, looks, weights, and more."),
]
Size = Annotated[str | None, typer.Option(metavar="WxH", help="Image size in pixels.")]
Quality = Annotated[
    str | None, typer.Option(help="fast, balanced, high, auto (by what draws), or a YAML file.  [default: auto]")
]
MinSuccess = Annotated[
    float | None,
    typer.Option(
        "--min-success", min=0, max=1, metavar="SHARE", help="Exit 5 if a smaller share of the trials succeeds."
    ),
]
ReportFile = Annotated[Path | None, typer.Option(help="Also write the JSON to this file.")]

# What each flag sets. A task comes before its parts.
_SETS: dict[str, tuple[str, ...]] = {
    "rig": ("rig",),
    "margin": ("rig", "margin"),
    "task": ("task",),
    "object": ("task", "object"),
    "target": ("task", "target"),
    "threshold": ("task", "success", "threshold"),
    "n": ("episodes",),
    "workers": ("workers",),
    "seed": ("seed",),
    "grasp": ("grasp",),
    "arm": ("arm",),
    "wrist": ("wrist",),
    "boards": ("boards",),
    "truth": ("truth",),
    "size": ("image", "size_px"),
    "jpeg_quality": ("image", "jpeg_quality"),
    "quality": ("render",),
    "randomize": ("randomization",),
}


def task_config(name: str, where: Locations, **given: Any) -> RecordConfig:
    """The named record config with flags put over it.

    Args:
        given: flags by their names; None for those that were not given. `randomize` keeps the ranges that a config has
            of its own.

    Raises:
        ConfigError, UsageError: a value is not valid; what cannot be demonstrated is told before anything is made.
    """
    from yamsim_cli.core.config.limits import check_start
    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.record import RecordConfig
    from yamsim_cli.core.tasks.kinds import kind_of

    if isinstance(size := given.get("size"), str):
        given["size"] = parse_size(size)
    if (randomize := given.get("randomize")) is not None:
        own = task_config(name, where, **(given | {"randomize": None})).randomization.parts
        given["randomize"] = (None if own else "default") if randomize else "none"
    overrides: dict[KeyPath, tuple[str, Any]] = {
        path: (f"--{flag.replace('_', '-')}", given[flag])
        for flag, path in _SETS.items()
        if given.get(flag) is not None
    }
    config = load_config(RecordConfig, "record", name, where, overrides)
    kind_of(config.task)
    check_start(config, where)
    return config


def drawn_config(name: str, *, parallel: bool = True, **given: Any) -> tuple[RecordConfig, Locations]:
    """`task_config` for what is to be drawn, with a quality that suits what draws, and where things are.

    Args:
        parallel: several processes draw, see `use_gl`.

    Raises:
        ConfigError, UsageError: a value is not valid. It is told before OpenGL is tried, which takes seconds.
    """
    where = locations()
    task_config(name, where, **given)
    where = use_gl(where, workers=parallel)
    return task_config(name, where, **given), where


def undrawn_config(name: str, **given: Any) -> tuple[RecordConfig, Locations]:
    """`task_config` for what draws nothing, and where things are."""
    where = locations()
    config = task_config(name, where, **given)
    skip_gl()
    return config, where
