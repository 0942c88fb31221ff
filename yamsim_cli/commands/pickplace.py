"""`yamsim pickplace batch`: `yamsim trials`, by the name that it has for the task `pickplace`."""

from __future__ import annotations

import typer

from .trials import trials

app = typer.Typer(help="Run pick-and-place trials.", no_args_is_help=True)


@app.callback()
def _pickplace() -> None:
    """Run pick-and-place trials."""


app.command(
    "batch",
    help="Run trials of the task pickplace without rendering, and count the successes: `yamsim trials` by another "
    "name.\n\nExample: yamsim pickplace batch --n 200 --seed 2 --json",
)(trials)
