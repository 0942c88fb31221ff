"""`yamsim view`: watch a rig and move its joints."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from .console import print_json, print_line
from .session import Json, Margin, RigName, locations, resolve_meshes, rig_config
from .signals import noted_signals
from .viewing import Port, Web, choose_viewer, prepare_viewer


def view(
    rig: RigName = "single",
    margin: Margin = None,
    web: Web = None,
    port: Port = None,
    boards: Annotated[bool, typer.Option("--boards/--no-boards", help="Base boards and their mounts.")] = True,
    json: Json = False,
) -> None:
    """Watch a rig in real time and move its joints: in MuJoCo's window, or in a page on 127.0.0.1. Ctrl-C ends it.

    Example: yamsim view --rig russet --web
    """
    page_port = choose_viewer(web, port)
    where = locations()
    settings = rig_config(rig, where, margin)
    prepare_viewer(page_port)

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
        if page_port is None:
            view_in_window(live, lambda: ready(None), stopped)
        else:
            view_in_browser(live, page_port, ready, stopped)
