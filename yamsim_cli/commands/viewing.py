"""What the commands that open a viewer share: which one it is, and what it needs before it is imported."""

from __future__ import annotations

import os
import sys
from typing import Annotated

import typer

from yamsim_cli.core.errors import ResourceError, UsageError

from .session import skip_gl

_PORT = 8090

Web = Annotated[
    bool | None, typer.Option("--web/--native", help="A browser page, or MuJoCo's own window on this display.")
]
Port = Annotated[
    int | None,
    typer.Option(min=0, max=65535, help=f"Of the browser page, {_PORT} unless given; 0 takes a free one."),
]


def choose_viewer(web: bool | None, port: int | None) -> int | None:
    """The browser page's port, or None for MuJoCo's window.

    The viewer is the one asked for, else the page where a port is given or no window can open.

    Raises:
        UsageError: a port for a window.
        ResourceError: a window where none can open.
    """
    missing = _missing_for_window()
    if web is False and port is not None:
        raise UsageError(f"--port {port} is for the browser page; leave it out, or give --web")
    if web is False and missing:
        raise ResourceError(f"--native needs {missing}: use --web")
    in_browser = web or (web is None and (port is not None or missing is not None))
    return (_PORT if port is None else port) if in_browser else None


def prepare_viewer(page_port: int | None) -> None:
    """Settle what MuJoCo draws with, before it is imported."""
    if page_port is None:
        os.environ["MUJOCO_GL"] = "glfw"
        return
    skip_gl()
    # Viser tells of its server on stdout, by rich's own console; ours are others.
    import rich

    rich.get_console().quiet = True


def _missing_for_window() -> str | None:
    if sys.platform == "darwin":
        # Where macOS wants windows: in the main thread, which MuJoCo's own interpreter keeps free for them.
        return None if "MJPYTHON_BIN" in os.environ else "MuJoCo's interpreter mjpython on macOS"
    if sys.platform == "win32" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        return None
    return "a display, and neither DISPLAY nor WAYLAND_DISPLAY is set"
