"""What commands need before they start: flags that most of them share, and what opens their sessions."""

from __future__ import annotations

import os
from typing import Annotated

import typer

from yamsim_cli.core.import_thing.named import config_of
from yamsim_cli.core.opener import Opener
from yamsim_cli.kitchen_scenes import task_of
from yamsim_cli.terminal.console import note, note_at_end
from yamsim_cli.terminal.fetch_bar import fetch_bar

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else.")]
RigName = Annotated[
    str,
    typer.Option(
        "--rig", help="Rig: a name from configs/rigs/, ROBOT+GRIPPER such as yam_pro+linear_4310, or a YAML file."
    ),
]
Revision = Annotated[
    str | None, typer.Option(help="Of the rig's robots, in place of the rig's own; `yamsim robots list` has them.")
]
Robot = Annotated[
    list[str] | None,
    typer.Option(
        metavar="FILE",
        help="How your arm moves otherwise than its model, as `yamsim identify` writes it: for all arms of that model. "
        "Give it again for another arm.",
    ),
]
Margin = Annotated[float | None, typer.Option(help="Distance between the arms, m, in place of the rig's own.")]


def _flag(setting: str) -> str:
    return f"--{setting.replace('_', '-')}"


# Its error messages name flags, and what it has to tell goes to stderr.
opener = Opener(os.environ, note, _flag, config_of, task_of, fetch_bar, note_at_end)


def _stay_offline(wanted: bool) -> bool:
    if wanted:
        opener.stay_offline()
    return wanted


# Acts when it is parsed, so that commands only have to declare it.
Offline = Annotated[
    bool,
    typer.Option(
        "--offline",
        callback=_stay_offline,
        help="Fetch no missing meshes and draw primitives in their place, as with YAMSIM_OFFLINE=1.",
    ),
]
