"""What several commands need before they can start: the flags that they share, and the session that they run in."""

from __future__ import annotations

import os
from typing import Annotated

import typer

from yamsim_cli.core.session import Opener

from .console import note

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else.")]
RigName = Annotated[str, typer.Option("--rig", help="Rig: a name from configs/rigs/ or a YAML file.")]
Margin = Annotated[float | None, typer.Option(help="Distance between the arms, m, in place of the rig's own.")]


def _flag(setting: str) -> str:
    return f"--{setting.replace('_', '-')}"


# Of this process: what is wrong is told by flag, and what a user should know on stderr.
opener = Opener(os.environ, note, _flag)
