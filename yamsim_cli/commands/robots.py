"""`yamsim robots`: which arms, grippers and stations there are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from yamsim_cli.core.errors import UsageError
from yamsim_cli.core.resources import Locations
from yamsim_cli.flags.session import Json, opener
from yamsim_cli.terminal.items import print_item, print_items

app = typer.Typer(
    help="List the arms, grippers and stations, show one, and make and check one of yours.", no_args_is_help=True
)


_WORDS = {True: "passed", False: "FAILED", None: "does not apply"}

_Data = Annotated[
    Path | None,
    typer.Option("--data", help="Your folder of data; without it, the one that YAMSIM_DATA_DIR names.", metavar="DIR"),
]


@app.command("list")
def list_robots(json: Json = False) -> None:
    """List arms, grippers and stations: what goes together, where figures are from, and whether meshes are here.

    An arm or a station that is not valid is listed with its fault.

    Example: yamsim robots list
    """
    from yamsim_cli.core.robot_catalog import robots_there
    from yamsim_cli.terminal.console import note

    items = robots_there(opener.locations())
    print_items(items, ["", "name", "of", "goes with", "source", "meshes"], _row, json)
    for item in items:
        if "fault" in item and not json:
            note(f"{item['name']} is not valid: {item['fault']}")


@app.command()
def show(
    name: Annotated[str, typer.Argument(help="Of an arm, a family of arms, a gripper or a station.")],
    json: Json = False,
) -> None:
    """Show one arm, gripper or station.

    Example: yamsim robots show yam_ultra
    """
    from yamsim_cli.core.robot_catalog import robot_there

    print_item(robot_there(name, opener.locations()), json, {"meshes": _told_meshes})


@app.command()
def new(
    name: Annotated[str, typer.Argument(help="Of the new arm: letters, digits and underscores.")],
    data: _Data = None,
    json: Json = False,
) -> None:
    """Write the files of a new arm, with comments, that pass `yamsim robots check`. No file is overwritten.

    Example: yamsim robots new my_arm --data my_data
    """
    from yamsim_cli.core.robot_catalog import new_robot
    from yamsim_cli.terminal.console import print_json, print_line

    where = _locations(data)
    if len(where.data) < 2:
        raise UsageError("no folder for the arm: give --data DIR, or set YAMSIM_DATA_DIR to a folder of yours")
    paths = new_robot(name, where.data[0], where)
    if json:
        print_json({"paths": [str(path) for path in paths]})
    else:
        for path in paths:
            print_line(str(path))
        print_line(f"Change them, then try them with `yamsim robots check {name}{f' --data {data}' if data else ''}`.")


@app.command()
def check(
    name: Annotated[str, typer.Argument(help="Of an arm.")],
    data: _Data = None,
    json: Json = False,
) -> None:
    """Check an arm with each gripper that fits: it compiles, and its drives hold it at home.

    The exit code is 3 if a file is not valid, and 5 if a check fails.

    Example: yamsim robots check yam_v1
    """
    opener.skip_gl()

    from yamsim_cli.core.robot_catalog import check_robot, require_checked
    from yamsim_cli.terminal.console import print_json, print_table
    from yamsim_cli.terminal.tables import listing

    found = check_robot(name, _locations(data))
    if json:
        print_json({"ok": all(one["ok"] is not False for one in found), "grippers": found})
    else:
        table = listing(["gripper", "", "found"], numbers_from=3)
        for one in found:
            table.add_row(one["gripper"], _WORDS[one["ok"]], one["detail"])
        print_table(table)
    require_checked(name, found)


def _locations(data: Path | None) -> Locations:
    """Where configs are; a folder given by --data comes first."""
    where = opener.locations()
    return where if data is None else replace(where, data=(data, *where.data))


def _row(item: Mapping[str, Any]) -> list[str]:
    goes_with = ", ".join(item["goes_with"])
    source = "NOT VALID, see below" if "fault" in item else item["source"] or ""
    return [item["kind"], item["name"], _of(item), goes_with, source, _meshes(item)]


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
