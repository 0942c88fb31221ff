"""`yamsim robots`: which arms, grippers and stations there are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import typer

from yamsim_cli.flags.session import Json, opener
from yamsim_cli.terminal.items import print_item, print_items

app = typer.Typer(help="List the arms, grippers and stations, and show one.", no_args_is_help=True)


@app.command("list")
def list_robots(json: Json = False) -> None:
    """List arms, grippers and stations: what goes together, where figures are from, and whether meshes are here.

    Example: yamsim robots list
    """
    from yamsim_cli.core.robots_there import robots_there

    print_items(robots_there(opener.locations()), ["", "name", "of", "goes with", "source", "meshes"], _row, json)


@app.command()
def show(
    name: Annotated[str, typer.Argument(help="Of an arm, a family of arms, a gripper or a station.")],
    json: Json = False,
) -> None:
    """Show one arm, gripper or station.

    Example: yamsim robots show yam_ultra
    """
    from yamsim_cli.core.robots_there import robot_there

    print_item(robot_there(name, opener.locations()), json, {"meshes": _told_meshes})


def _row(item: Mapping[str, Any]) -> list[str]:
    goes_with = ", ".join(item["goes_with"])
    return [item["kind"], item["name"], _of(item), goes_with, item["source"] or "", _meshes(item)]


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


def _told_meshes(meshes: Mapping[str, bool]) -> str:
    return ", ".join(f"{name}: {'here' if here else 'not here'}" for name, here in meshes.items()) or "none"
