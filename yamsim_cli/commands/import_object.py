"""`yamsim assets import`: make an object's config from its scan, or from a file of any thing."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from yamsim_cli.core.errors import ResourceError, UsageError
from yamsim_cli.flags.session import Json, opener
from yamsim_cli.terminal.console import note, print_json, print_line, progress_bar

from .certify_object import brief, certify_named, failure

if TYPE_CHECKING:
    from yamsim_cli.core.import_thing.from_file import ImportedFile
    from yamsim_cli.core.import_thing.ycb import ImportedObject


def import_object(
    source: Annotated[
        str,
        typer.Argument(
            metavar="YCB_ID|FILE",
            help="A YCB object such as 013_apple, or a file: .sdf .glb .gltf .obj .stl .ply .dae .urdf .xml (MJCF).",
        ),
    ],
    name: Annotated[str | None, typer.Option(help="What the thing of a file is called.  [default: the file's]")] = None,
    mass: Annotated[
        float | None, typer.Option(min=5e-4, max=50, help="Mass in kg; by default what is published, or the file says.")
    ] = None,
    density: Annotated[
        float | None, typer.Option(min=1, max=25_000, help="Density in kg/m3, in place of a mass: of an even filling.")
    ] = None,
    unit: Annotated[
        Literal["m", "cm", "mm", "in"] | None, typer.Option(help="The file's unit, where it does not say.")
    ] = None,
    up: Annotated[
        Literal["x", "y", "z"] | None, typer.Option(help="Which of its axes is up, where it does not say.")
    ] = None,
    scale: Annotated[float, typer.Option(min=1e-6, max=1e6, help="What all lengths are multiplied by.")] = 1.0,
    collision: Annotated[
        Literal["auto", "primitives", "decompose", "sdf", "hull"],
        typer.Option(help="auto: as the file says, or primitives within 1.5 mm, or else convex parts."),
    ] = "auto",
    base: Annotated[
        Literal["free", "fixed"] | None, typer.Option(help="Whether it can be moved; by default as the file says.")
    ] = None,
    friction: Annotated[float | None, typer.Option(min=0.01, max=5, help="Sliding friction.")] = None,
    out: Annotated[
        Path | None, typer.Option(help="The YAML file to write.  [default: $YAMSIM_DATA_DIR/configs/objects/NAME.yaml]")
    ] = None,
    certify: Annotated[
        bool, typer.Option("--certify/--no-certify", help="Check the thing in physics, as `assets certify` does.")
    ] = True,
    json: Json = False,
) -> None:
    """Make an object's config: looks, what touches, inertia and grasps. Exit code 4 where a check of it fails.

    Example: yamsim assets import mug.stl --name my_mug --mass 0.3 --out my_mug.yaml
    """
    from yamsim_cli.core.thing_files import ENDINGS

    where = opener.locations()
    if Path(source).suffix.lower() not in ENDINGS:
        from yamsim_cli.core.import_thing.ycb import import_ycb

        if name is not None:
            raise UsageError("--name is for a file of your own; a YCB object has its name")
        made = import_ycb(source, where, None if mass is None else mass * 1000, out)
        _tell(_ycb_item(made), _ycb_lines(made), certify=certify, json=json)
        return
    from yamsim_cli.core.import_thing.from_file import import_file, name_of
    from yamsim_cli.core.thing_files.read import UnitOptions
    from yamsim_cli.core.things.make import ImportOptions

    if mass is not None and density is not None:
        raise UsageError("--mass and --density: give one of them")
    file = Path(source)
    options = ImportOptions(name or name_of(file), mass, density, collision, base, friction)
    with progress_bar(f"importing {file.name}", "%") as advance:
        units = UnitOptions(unit, up, scale)
        imported = import_file(file, units, options, where, out, lambda done: advance(round(100 * done), 100))
    for text in (*imported.made.notes, *_guesses(imported)):
        note(f"{file.name}: {text}")
    _tell(_item(imported), _lines(imported), certify=certify, json=json)


def _tell(item: dict[str, Any], lines: list[str], *, certify: bool, json: bool) -> None:
    """Certify what was imported unless told not to, and print it.

    Raises:
        ResourceError: a check failed; the config stays where it was written.
    """
    certified = None
    if certify:
        opener.skip_gl()
        certified = certify_named(item["path"])
    item["certificate"] = certified and brief(certified)
    if json:
        print_json({"items": [item]})
    else:
        for line in lines:
            print_line(line)
    if certified is not None:
        if not certified.ok:
            raise ResourceError(f"{item['path']} is written, but its certificate failed: {failure(certified)}")
        note("Certificate: passed")


def _ycb_item(made: ImportedObject) -> dict[str, Any]:
    fit, data = made.description.fit, made.description.data
    return {
        "name": data["name"],
        "path": str(made.path),
        "primitives": [part.type for part in fit.parts],
        "rms_mm": round(fit.rms * 1000, 3),
        "p99_mm": round(fit.most * 1000, 3),
        "width_mm": round(2000 * data["grasp"]["opening"], 1) if "grasp" in data else None,
        "vessel": "grasp" not in data,
    }


def _ycb_lines(made: ImportedObject) -> list[str]:
    item = _ycb_item(made)
    kinds = ", ".join(item["primitives"])
    held = f"{item['width_mm']:g} mm wide where it is held" if item["width_mm"] else "a vessel to put things in or on"
    return [
        f"{item['path']}: {kinds}; {item['rms_mm']:.1f} mm off the scan (rms), 99 % within {item['p99_mm']:.1f} mm",
        f"{item['name']} is {held}; look the file over: its colour and friction are guesses",
    ]


def _guesses(imported: ImportedFile) -> list[str]:
    made, said = imported.made, []
    if made.guessed:
        kind = "evenly filled" if made.closed else "as a sheet 2 mm thick, since its surface encloses nothing"
        said.append(f"{made.mass * 1000:.3g} g is a guess, {kind} with 1,000 kg/m3: give --mass or --density")
    return said


def _item(imported: ImportedFile) -> dict[str, Any]:
    config, made = imported.config, imported.made
    fits = [geometry.fit for geometry in made.collision if geometry.fit is not None]
    return {
        "name": config.name,
        "path": str(imported.path),
        "set": config.mesh.set,
        "mass_kg": round(made.mass, 6),
        "mass_is_a_guess": made.guessed,
        "closed": made.closed,
        "collision": {
            "kind": made.collision[0].kind,
            "parts": sum(len(geometry.parts) for geometry in made.collision),
            "p99_mm": round(1000 * max(fit.most for fit in fits), 3) if fits else None,
        },
        "meshes": len(config.all_meshes),
        "textures": sum(mesh.texture is not None for mesh in config.all_meshes),
        "links": [link.name for link in config.links],
        "width_mm": None if config.grasp is None else round(2000 * config.grasp.opening, 1),
        "carries": config.carries,
    }


def _lines(imported: ImportedFile) -> list[str]:
    item = _item(imported)
    collision = item["collision"]
    near = "" if collision["p99_mm"] is None else f", 99 % within {collision['p99_mm']:.1f} mm of the surface"
    held = "nothing of it fits between fingers" if item["width_mm"] is None else f"{item['width_mm']:g} mm wide"
    moves = f"; moves: {', '.join(item['links'])}" if item["links"] else ""
    return [
        f"{item['path']}: collides by {collision['kind']} ({collision['parts']} parts{near}), "
        f"{item['textures']} of {item['meshes']} meshes with a picture{moves}",
        f"{item['name']}: {item['mass_kg'] * 1000:.4g} g, {held} where it is held",
    ]
