"""`yamsim render-views`: render pictures of a rig."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from yamsim_cli.flags.output_files import Overwrite, require_unused_paths
from yamsim_cli.flags.session_options import Json, Margin, Offline, Quality, Revision, RigName, Robot, session_opener
from yamsim_cli.session_opener import parse_size
from yamsim_cli.terminal.console import print_json, print_line


def render_views(
    rig: RigName = "single",
    revision: Revision = None,
    robot: Robot = None,
    out: Annotated[Path, typer.Option(help="Folder for the pictures.")] = Path("views"),
    size: Annotated[str, typer.Option(metavar="WxH", help="Size of each view in pixels.")] = "960x720",
    quality: Quality = None,
    margin: Margin = None,
    overwrite: Overwrite = False,
    offline: Offline = False,
    json: Json = False,
) -> None:
    """Render a rig from the front, from nearly above and from close by, and a montage of the three.

    Example: yamsim render-views --rig russet
    """
    where = session_opener.find_locations()
    settings = session_opener.load_rig(rig, where, margin, revision, robot)
    pixels = parse_size(size)

    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.rendering import RenderConfig
    from yamsim_cli.core.config.scene import SceneConfig
    from yamsim_cli.viewers.show.rig_views import picture_names

    require_unused_paths("--out", [out / name for name in picture_names()], overwrite=overwrite)
    scene = load_config(SceneConfig, "scenes", "studio", where)
    # Refuse an unknown quality before the choice of an OpenGL backend, which takes seconds.
    load_config(RenderConfig, "quality", quality or "auto", where)
    where = session_opener.choose_gl_backend(where)
    render = load_config(RenderConfig, "quality", quality or "auto", where)

    from yamsim_cli.core.scene.blueprint import Blueprint
    from yamsim_cli.core.scene.compose import visual_mesh_sets
    from yamsim_cli.viewers.show.rig_views import render_views as run
    from yamsim_cli.viewers.show.rig_views import set_up_views, write_views

    blueprint = Blueprint(settings, scene)
    where = session_opener.with_mesh_folders(where, visual_mesh_sets(blueprint), render)
    files = write_views(run(set_up_views(blueprint, where, render, pixels)), out)
    if json:
        print_json({"files": [str(file) for file in files]})
    else:
        print_line(f"{files[-1]}, and each view beside it")
