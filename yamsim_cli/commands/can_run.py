"""`yamsim can-run`: a program that finds the simulated arms where the real ones would be."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from yamsim_cli.core.errors import ResourceError, UsageError
from yamsim_cli.core.serve.sockets import default_folder
from yamsim_cli.terminal.console import print_json

Folder = Annotated[
    Path | None, typer.Option(metavar="DIRECTORY", help="Where the buses' sockets lie.  [default: one of yours]")
]


def bus_folder(given: Path | None) -> Path:
    """The folder of the buses' sockets: the one that was named, or one of the user's own."""
    return default_folder(os.environ) if given is None else given


def can_run(
    program: Annotated[list[str], typer.Argument(metavar="PROGRAM...", help="The program, and what it is told.")],
    folder: Folder = None,
    json: Annotated[
        bool, typer.Option("--json", help="Run nothing; print the variables that the program would get, as JSON.")
    ] = False,
) -> None:
    """Run a program of python-can's with the buses of `yamsim serve-robot` in place of the machine's own.

    Example: yamsim can-run -- python -m i2rt.robots.motor_chain_robot --channel can0
    """
    from yamsim_cli.core.serve.can_bus import program_environment

    where = bus_folder(folder)
    added = program_environment(os.environ, where)
    if json:
        print_json({"program": program, "environ": added})
        return
    try:
        os.execvpe(program[0], program, {**os.environ, **added})
    except OSError as error:
        kind = UsageError if isinstance(error, FileNotFoundError) else ResourceError
        raise kind(f"{program[0]}: cannot be run: {error.strerror}") from error
