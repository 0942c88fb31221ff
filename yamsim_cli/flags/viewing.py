"""Shared by the commands that open a viewer: which viewer it is, and what has to be set before it is imported."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Annotated

import typer

from yamsim_cli.core.errors import ResourceError, UsageError
from yamsim_cli.terminal.console import note

from .session import opener

if TYPE_CHECKING:
    from yamsim_cli.core.viewers.address import PageAddress

_PORT = 8090

Web = Annotated[
    bool | None, typer.Option("--web/--native", help="A browser page, or MuJoCo's own window on this display.")
]
Port = Annotated[
    int | None,
    typer.Option(min=0, max=65535, help=f"Port of the browser page, {_PORT} unless given; 0 takes a free one."),
]
Host = Annotated[
    str | None,
    typer.Option(
        help="Where the browser page listens: an address of this machine, 127.0.0.1 unless given; 0.0.0.0 is all."
    ),
]


def page_address(port: int | None, host: str | None) -> PageAddress:
    """Where a browser page is to listen. The user is warned if others can reach it."""
    from yamsim_cli.core.viewers.address import LOOPBACK, PageAddress

    address = PageAddress(_PORT if port is None else port, host or LOOPBACK)
    if not address.is_private:
        note(
            f"Whoever reaches {address.host} can watch and move what the page shows: it asks for no password and "
            "encrypts nothing. Safer: leave --host out, and come through ssh -L."
        )
    return address


def choose_viewer(web: bool | None, port: int | None, host: str | None = None) -> PageAddress | None:
    """The browser page's address, or None for MuJoCo's window.

    The viewer is the one asked for, else the page where a port or host is given or no window can open.

    Raises:
        UsageError: a port or host for a window.
        ResourceError: a window where none can open.
    """
    missing = _missing_for_window()
    for flag, value in (("--port", port), ("--host", host)):
        if web is False and value is not None:
            raise UsageError(f"{flag} {value} is for the browser page; leave it out, or give --web")
    if web is False and missing:
        raise ResourceError(f"--native needs {missing}: use --web")
    in_browser = web or (web is None and any(given is not None for given in (port, host, missing)))
    return page_address(port, host) if in_browser else None


def prepare_viewer(page: PageAddress | None) -> None:
    """Tell MuJoCo how to open its OpenGL, before it is imported, unless that is settled already."""
    if page is None:
        os.environ["MUJOCO_GL"] = "glfw"
        return
    opener.skip_gl()
    quiet_page()


def quiet_page() -> None:
    """Keep the page's library from writing to stdout."""
    # Viser announces its server on stdout through rich's global console, which yamsim does not use.
    import rich

    rich.get_console().quiet = True


def _missing_for_window() -> str | None:
    if sys.platform == "darwin":
        # macOS opens windows in the main thread only, and MuJoCo's interpreter keeps that thread free for them.
        return None if "MJPYTHON_BIN" in os.environ else "MuJoCo's interpreter mjpython on macOS"
    if sys.platform == "win32" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        return None
    return "a display, and neither DISPLAY nor WAYLAND_DISPLAY is set"
