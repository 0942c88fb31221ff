"""The flags that are shared by commands that run a task."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

ConfigOption = Annotated[
    str,
    typer.Option("--config", metavar="NAME|FILE", help="Record config: a name from configs/record/ or a YAML file."),
]
Rig = Annotated[
    str | None,
    typer.Option(help="Rig: a name from configs/rigs/, ROBOT+GRIPPER such as yam_pro+linear_4310, or a YAML file."),
]
Cameras = Annotated[
    list[str] | None,
    typer.Option("--camera", metavar="NAME", help="A camera to record; give it again for others."),
]
Task = Annotated[str | None, typer.Option(help="Task: a name from configs/tasks/ or a YAML file.")]
Object = Annotated[
    str | None,
    typer.Option(
        "--object", metavar="NAME|FILE", help="What is picked up: a name from configs/objects/ or a YAML file."
    ),
]
Target = Annotated[
    str | None, typer.Option(metavar="NAME|FILE", help="What it is put onto or into: also from configs/objects/.")
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
Randomization = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Ranges to vary by: a name from configs/randomization/ or a YAML file; `arms` has delays, noise, encoder "
        "steps and errors of the gravity compensation.  [default: with --randomize, `default`]",
    ),
]
Size = Annotated[str | None, typer.Option(metavar="WxH", help="Image size in pixels.")]
Quality = Annotated[
    str | None, typer.Option(help="fast, balanced, high, auto (GPU or not), or a YAML file.  [default: auto]")
]
MinSuccess = Annotated[
    float | None,
    typer.Option(
        "--min-success", min=0, max=1, metavar="SHARE", help="Exit 5 if a smaller share of the trials succeeds."
    ),
]
ReportFile = Annotated[Path | None, typer.Option(help="Also write the JSON to this file.")]
