"""`yamsim render-views`: pictures of a rig."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from yamsim_cli.core.session import parse_size

from .console import print_json, print_line
from .session import Json, Margin, RigName, opener
from .settings import Quality


def render_views(
    rig: RigName = "single",
    out: Annotated[Path, typer.Option(help="Folder for the pictures.")] = Path("views"),
    size: Annotated[str, typer.Option(metavar="WxH", help="Size of each view in pixels.")] = "960x720",
    quality: Quality = None,
    margin: Margin = None,
    json: Json = False,
) -> None:
    """Render a rig from the front, from nearly above and from close by, and a montage of the three.

    Example: yamsim render-views --rig russet
    """
    where = opener.locations()
    settings = opener.rig(rig, where, margin)
    pixels = parse_size(size)

    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.recording import RenderConfig
    from yamsim_cli.core.config.scene import SceneConfig

    scene = load_config(SceneConfig, "scenes", "studio", where)
    # Once without OpenGL: what is wrong with it is told at once.
    load_config(RenderConfig, "quality", quality or "auto", where)
    spending = load_config(RenderConfig, "quality", quality or "auto", opener.use_gl(where))

    from yamsim_cli.core.scene.compose import mesh_sets
    from yamsim_cli.core.show.views import render_views as run
    from yamsim_cli.core.show.views import set_stage, write_views

    stage = set_stage(
        settings,
        scene,
        spending,
        pixels,
        where,
        opener.meshes(mesh_sets(settings), where, reduced=spending.reduced_meshes),
    )
    files = write_views(run(settings, stage), out)
    if json:
        print_json({"files": [str(file) for file in files]})
    else:
        print_line(f"{files[-1]}, and each view beside it")
