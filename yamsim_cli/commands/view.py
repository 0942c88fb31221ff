"""`yamsim view`: watch a rig and move its joints."""

from __future__ import annotations

import os
import sys
from typing import Annotated

import typer

from yamsim_cli.core.errors import ResourceError, UsageError

from .console import print_json, print_line
from .session import Json, Margin, RigName, locations, resolve_meshes, rig_config, skip_gl
from .signals import noted_signals

_PORT = 8090


def view(
    rig: RigName = "single",
    margin: Margin = None,
    web: Annotated[
        bool | None,
        typer.Option("--web/--native", help="A browser page, or MuJoCo's own window on this display."),
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help=f"Of the browser page, {_PORT} unless given; 0 takes a free one."),
    ] = None,
    boards: Annotated[bool, typer.Option("--boards/--no-boards", help="Base boards and their mounts.")] = True,
    json: Json = False,
) -> None:
    """Watch a rig in real time and move its joints: in MuJoCo's window, or in a page on 127.0.0.1. Ctrl-C ends it.

    Example: yamsim view --rig russet --web
    """
    in_browser = _in_browser(web, port)
    where = locations()
    settings = rig_config(rig, where, margin)
    if in_browser:
        skip_gl()
        _hush_viser()
    else:
        os.environ["MUJOCO_GL"] = "glfw"

    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.scene import SceneConfig
    from yamsim_cli.core.jobs.view import live_rig, view_in_browser, view_in_window
    from yamsim_cli.core.scene.compose import Contents, mesh_sets

    def ready(url: str | None) -> None:
        if json:
            print_json({"url": url})
        else:
            print_line(f"{url}  (Ctrl-C ends)" if url else "MuJoCo's window: space pauses, backspace goes home")
        # Whoever reads a pipe must not have to wait for the end.
        sys.stdout.flush()

    scene = load_config(SceneConfig, "scenes", "studio", where)
    meshes = resolve_meshes(mesh_sets(settings), where)
    # A server or a window that is broken off while it starts cannot be closed.
    with noted_signals() as stopped:
        live = live_rig(settings, scene, Contents(boards=boards), where, meshes)
        if in_browser:
            view_in_browser(live, _PORT if port is None else port, ready, stopped)
        else:
            view_in_window(live, lambda: ready(None), stopped)


def _in_browser(web: bool | None, port: int | None) -> bool:
    """Which viewer it is: the one asked for, else the page where a port is given or no window can open."""
    missing = _missing_for_window()
    if web is None:
        return port is not None or missing is not None
    if not web and port is not None:
        raise UsageError(f"--port {port} is for the browser page; leave it out, or give --web")
    if not web and missing:
        raise ResourceError(f"--native needs {missing}: use --web")
    return web


def _missing_for_window() -> str | None:
    if sys.platform == "darwin":
        # Where macOS wants windows: in the main thread, which MuJoCo's own interpreter keeps free for them.
        return None if "MJPYTHON_BIN" in os.environ else "MuJoCo's interpreter mjpython on macOS"
    if sys.platform == "win32" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        return None
    return "a display, and neither DISPLAY nor WAYLAND_DISPLAY is set"


def _hush_viser() -> None:
    """Viser tells of its server on stdout, by rich's own console; ours are others."""
    import rich

    rich.get_console().quiet = True
