"""The `yamsim` command line: registers the commands, and converts errors to messages and exit codes."""

from __future__ import annotations

import errno
import platform
import re
import sys
from collections.abc import Callable
from importlib.metadata import version
from typing import Annotated, Any, NoReturn

import typer
from typer.exceptions import TyperException

from . import __version__
from .commands import assets, config, export, robots, tasks
from .commands.boards import boards
from .commands.calibrate import calibrate
from .commands.compose_xml import compose_xml
from .commands.correct import correct
from .commands.derive import filter_dataset, merge, split
from .commands.doctor import doctor
from .commands.draw import draw
from .commands.evaluate import evaluate
from .commands.gap import gap
from .commands.identify import excite, identify
from .commands.import_recording import import_recording
from .commands.match import match
from .commands.mcp import mcp
from .commands.overlay import overlay
from .commands.record import record
from .commands.render_views import render_views
from .commands.replay import replay
from .commands.review import review
from .commands.serve_policy import serve_policy
from .commands.serve_robot import run_can_program, serve_robot
from .commands.summarize import summarize
from .commands.teleop import teleop
from .commands.trials import pickplace, trials
from .commands.verify import verify
from .commands.view import view
from .core.errors import ResourceError, YamsimError
from .terminal.console import write_end_notes
from .terminal.signals import raise_signals

app = typer.Typer(
    name="yamsim",
    help="Simulation toolkit for the I2RT YAM arm.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
)
app.command()(record)
app.command()(summarize)
app.command()(draw)
app.command()(verify)
app.command()(replay)
app.command()(review)
app.command()(merge)
app.command()(split)
app.command("filter")(filter_dataset)
app.command("eval")(evaluate)
app.command()(correct)
app.command("serve-policy")(serve_policy)
app.command("serve-robot")(serve_robot)
app.command("can-run")(run_can_program)
app.command("compose-xml")(compose_xml)
app.command("render-views")(render_views)
app.command()(overlay)
app.command()(match)
app.command()(calibrate)
app.command()(identify)
app.command()(excite)
app.command()(gap)
app.command("import")(import_recording)
app.command()(boards)
app.command()(view)
app.command()(mcp)
app.command()(doctor)
app.add_typer(export.app, name="export")
app.command()(teleop)
app.command()(trials)
app.add_typer(pickplace, name="pickplace")
app.add_typer(config.app, name="config")
app.add_typer(robots.app, name="robots")
app.add_typer(tasks.app, name="tasks")
app.add_typer(assets.app, name="assets")

# Packages whose versions affect recorded data; `yamsim doctor` shows all.
_SHOWN_PACKAGES = ("mujoco", "mink", "numpy", "opencv-python-headless")


def _show_version(wanted: bool) -> None:
    if wanted:
        packages = ", ".join(f"{name} {version(name)}" for name in _SHOWN_PACKAGES)
        sys.stdout.write(f"yamsim {__version__}\nPython {platform.python_version()}, {packages}\n")
        raise typer.Exit


@app.callback()
def _main_options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show versions and exit."),
    ] = False,
) -> None:
    """Simulation toolkit for the I2RT YAM arm: recorded demonstrations on MuJoCo."""


_INTERRUPTED_CODE = 130  # exit code after a signal
# Commands that run until a signal, which gives exit code 0.
_ENDED_BY_SIGNAL = ("view", "serve-policy", "review")


def main(interrupted: Callable[[], bool] = lambda: False) -> NoReturn:
    """Run the command line, and exit. A `YamsimError` gives one line and its exit code, other errors a traceback and 1.

    Args:
        interrupted: returns whether a signal arrived before this call.
    """
    raise_signals()
    try:
        if interrupted():
            raise KeyboardInterrupt
        code = app(standalone_mode=False)
        if code == _INTERRUPTED_CODE:
            # Typer converts a KeyboardInterrupt to this exit code.
            raise KeyboardInterrupt
        write_end_notes()
    except YamsimError as error:
        _exit_with_error(str(error), error.exit_code)
    except OSError as error:
        # Any access to a path from the user raises this error if the path is too long.
        if error.errno != errno.ENAMETOOLONG:
            raise
        _exit_with_error(
            f"{error.filename} is not a valid path: a name may have 255 bytes, and a whole path 4,095",
            ResourceError.exit_code,
        )
    except TyperException as error:
        if message := error.format_message():
            _exit_with_error(
                f"{message.rstrip('.')}{_decimal_point(error)}; see {_command_of_error(error)} --help", error.exit_code
            )
        sys.exit(error.exit_code)
    except (typer.Abort, KeyboardInterrupt):
        if len(sys.argv) > 1 and sys.argv[1] in _ENDED_BY_SIGNAL:
            sys.exit(0)
        _exit_with_error("interrupted", _INTERRUPTED_CODE)
    sys.exit(code if isinstance(code, int) else 0)


def _command_of_error(error: TyperException) -> str:
    names, context = list[str](), getattr(error, "ctx", None)
    while context is not None and context.parent is not None:
        names.insert(0, context.info_name)
        context = context.parent
    return " ".join(("yamsim", *names))


def _decimal_point(error: TyperException) -> str:
    """Return a hint if a number has a decimal comma."""
    # Typer validates values with pydantic, whose error is the `__cause__`.
    checked: list[dict[str, Any]] = getattr(error.__cause__, "errors", list)()
    given = str(checked[0].get("input")) if checked else ""
    if not re.fullmatch(r"[-+]?[0-9]+,[0-9]+", given):
        return ""
    return f": {given!r} has a decimal comma; write {given.replace(',', '.')}"


def _exit_with_error(message: str, code: int) -> NoReturn:
    sys.stderr.write(f"yamsim: {message}\n")
    sys.exit(code)


if __name__ == "__main__":
    main()
