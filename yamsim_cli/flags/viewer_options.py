"""Flags and choice of a viewer, and settings before the import of MuJoCo."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Annotated

import typer

from yamsim_cli.core.errors import ResourceError, UsageError
from yamsim_cli.terminal.console import print_note

from .session_options import session_opener

if TYPE_CHECKING:
    from yamsim_cli.viewers.page_address import PageAddress

_DEFAULT_PORT = 8090  # TCP port of the browser page

WebOrNative = Annotated[
    bool | None, typer.Option("--web/--native", help="A browser page, or MuJoCo's own window on this display.")
]
Port = Annotated[
    int | None,
    typer.Option(
        min=0, max=65535, help=f"Port of the browser page, by default {_DEFAULT_PORT}; 0 selects a free port."
    ),
]
Host = Annotated[
    str | None,
    typer.Option(help="Address on which the browser page listens, by default 127.0.0.1; 0.0.0.0 means all addresses."),
]


def page_address(port: int | None, host: str | None) -> PageAddress:
    """Return the address of a browser page. Warn if other machines can reach the page."""
    from yamsim_cli.viewers.page_address import LOOPBACK, PageAddress

    address = PageAddress(_DEFAULT_PORT if port is None else port, host or LOOPBACK)
    if not address.is_private:
        print_note(
            f"Anyone who reaches {address.host} can watch and move what the page shows: the page asks for no password "
            "and encrypts nothing. Safer: leave --host out, and use ssh -L."
        )
    return address


def choose_viewer(web: bool | None, port: int | None, host: str | None) -> PageAddress | None:
    """Return the browser page's address, or None for MuJoCo's window.

    If `web` is None, the page is chosen for a given port or host, or if no window can open.
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
    """Select GLFW for MuJoCo's window, or no OpenGL for a page. Call before MuJoCo is imported."""
    if page is None:
        os.environ["MUJOCO_GL"] = "glfw"
        return
    session_opener.disable_gl()
    silence_viser()


def silence_viser() -> None:
    """Silence rich's global console, because the web server viser announces itself on stdout."""
    import rich

    rich.get_console().quiet = True


def _missing_for_window() -> str | None:
    if sys.platform == "darwin":
        # macOS opens windows only in the main thread, which MuJoCo's interpreter keeps free.
        return None if "MJPYTHON_BIN" in os.environ else "MuJoCo's interpreter mjpython on macOS"
    if sys.platform == "win32" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        return None
    return "a display, and neither DISPLAY nor WAYLAND_DISPLAY is set"
