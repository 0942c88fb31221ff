"""`yamsim robots`: which arms, grippers and stations there are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import typer

from .session import Json, opener

app = typer.Typer(help="List the arms, grippers and stations, and show one.", no_args_is_help=True)


@app.command("list")
def list_robots(json: Json = False) -> None:
    """List arms, grippers and stations: what goes together, where figures are from, and whether meshes are here.

    Example: yamsim robots list
    """
    from yamsim_cli.core.robots_there import robots_there

    from .console import print_json, print_table
    from .tables import listing

    items = robots_there(opener.locations())
    if json:
        print_json({"items": list(items)})
        return
    headings = ["", "name", "of", "goes with", "source", "meshes"]
    table = listing(headings, numbers_from=len(headings))
    for item in items:
        table.add_row(
            item["kind"], item["name"], _of(item), ", ".join(item["goes_with"]), item["source"] or "", _meshes(item)
        )
    print_table(table)


@app.command()
def show(
    name: Annotated[str, typer.Argument(help="Of an arm, a family of arms, a gripper or a station.")],
    json: Json = False,
) -> None:
    """Show one arm, gripper or station.

    Example: yamsim robots show yam_ultra
    """
    from yamsim_cli.core.robots_there import robot_there

    from .console import print_json, print_table
    from .tables import facts

    item = robot_there(name, opener.locations())
    if json:
        print_json({"items": [item]})
        return
    print_table(facts((key.replace("_", " "), _text(key, value)) for key, value in item.items() if value is not None))


def _of(item: Mapping[str, Any]) -> str:
    """The family and revision of an arm; nothing of anything else."""
    if item.get("family") is None:
        return ""
    return f"{item['family']} {item['revision']}" + (" (newest)" if item["newest"] else "")


def _meshes(item: Mapping[str, Any]) -> str:
    missing = [name for name, here in item["meshes"].items() if not here]
    if not item["meshes"]:
        return "none"
    return f"yamsim assets fetch {' '.join(missing)}" if missing else "here"


def _text(key: str, value: Any) -> str:
    if key == "meshes":
        return ", ".join(f"{name}: {'here' if here else 'not here'}" for name, here in value.items()) or "none"
    if isinstance(value, list):
        return ", ".join(map(str, value))
    return str(value)
