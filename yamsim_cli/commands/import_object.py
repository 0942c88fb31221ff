"""`yamsim assets import`: make an object's config from its scan."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from yamsim_cli.core.errors import UsageError

from .console import print_json, print_line
from .session import Json, opener


def import_object(
    source: Annotated[
        str,
        typer.Argument(metavar="YCB_ID|FILE.stl", help="A YCB object such as 013_apple, or a binary STL in metres."),
    ],
    name: Annotated[str | None, typer.Option(help="With an STL: what the object is called.")] = None,
    mass: Annotated[
        float | None, typer.Option(min=5e-4, max=50, help="In kg; by default a YCB object's published one.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="The YAML file to write.  [default: $YAMSIM_DATA_DIR/configs/objects/NAME.yaml]")
    ] = None,
    json: Json = False,
) -> None:
    """Fit primitives to a scan, work out inertia and grasps, and write the object's config.

    Example: yamsim assets import mug.stl --name my_mug --mass 0.3 --out my_mug.yaml
    """
    from yamsim_cli.core.import_thing import import_stl, import_ycb

    where = opener.locations()
    mass_g = None if mass is None else mass * 1000
    if not source.lower().endswith(".stl"):
        if name is not None:
            raise UsageError("--name is for an STL of your own; a YCB object has its name")
        made = import_ycb(source, where, mass_g, out)
    elif name is None or mass_g is None:
        raise UsageError(f"{source}: give --name and --mass with an STL of your own")
    else:
        made = import_stl(Path(source), name, mass_g, where, out)
    fit, data = made.description.fit, made.description.data
    item = {
        "name": data["name"],
        "path": str(made.path),
        "primitives": [part.type for part in fit.parts],
        "rms_mm": round(fit.rms * 1000, 3),
        "p99_mm": round(fit.most * 1000, 3),
        "width_mm": round(2000 * data["grasp"]["opening"], 1) if "grasp" in data else None,
        "vessel": "grasp" not in data,
    }
    if json:
        print_json({"items": [item]})
        return
    kinds = ", ".join(item["primitives"])
    held = f"{item['width_mm']:g} mm wide where it is held" if item["width_mm"] else "a vessel to put things in or on"
    print_line(
        f"{item['path']}: {kinds}; {item['rms_mm']:.1f} mm off the scan (rms), 99 % within {item['p99_mm']:.1f} mm"
    )
    print_line(f"{item['name']} is {held}; look the file over: its colour and friction are guesses")
