from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from yamsim_cli.core.errors import UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.flags.session_options import Json, session_opener
from yamsim_cli.terminal.console import print_json, print_line, print_note, print_report
from yamsim_cli.terminal.tables import ItemTable, print_item, print_items

app = typer.Typer(
    help="List and show arms, grippers and stations, and make and check your own arm.", no_args_is_help=True
)

_CHECK_RESULT_LABELS = {True: "passed", False: "FAILED", None: "does not apply"}

_RobotDataFolder = Annotated[
    Path | None,
    typer.Option("--data", help="Your folder of data.  [default: $YAMSIM_DATA_DIR]", metavar="DIR"),
]


@app.command("list")
def list_robots(json: Json = False) -> None:
    """List arms, grippers and stations with compatible models, the source of their figures, and their meshes.

    An arm or a station that is not valid is listed with its fault.

    Example: yamsim robots list
    """
    from yamsim_cli.robot_catalog import robot_entries

    items = robot_entries(session_opener.find_locations())
    print_items(items, ["", "name", "of", "goes with", "source", "meshes"], _robot_row, json)
    for item in items:
        if "fault" in item and not json:
            print_note(f"{item['name']} is not valid: {item['fault']}")


@app.command()
def show(
    name: Annotated[str, typer.Argument(help="Name of an arm, a family of arms, a gripper or a station.")],
    json: Json = False,
) -> None:
    """Show one arm, gripper or station.

    Example: yamsim robots show yam_ultra
    """
    from yamsim_cli.robot_catalog import robot_entry

    print_item(robot_entry(name, session_opener.find_locations()), json, {"meshes": _mesh_states})


@app.command()
def new(
    name: Annotated[str, typer.Argument(help="The new arm's name: letters, digits and underscores.")],
    data: _RobotDataFolder = None,
    json: Json = False,
) -> None:
    """Write commented files of a new arm that pass `yamsim robots check`. No file is overwritten.

    Example: yamsim robots new my_arm --data my_data
    """
    from yamsim_cli.robot_catalog import write_robot_template

    where = _locations_with_data(data)
    if len(where.data) < 2:
        raise UsageError("no folder for the arm: give --data DIR, or set YAMSIM_DATA_DIR to a folder of yours")
    paths = write_robot_template(name, where.data[0], where)
    if json:
        print_json({"paths": [str(path) for path in paths]})
    else:
        for path in paths:
            print_line(str(path))
        print_line(f"Change them, then try them with `yamsim robots check {name}{f' --data {data}' if data else ''}`.")


@app.command()
def check(
    name: Annotated[str, typer.Argument(help="An arm's name.")],
    data: _RobotDataFolder = None,
    json: Json = False,
) -> None:
    """Check an arm with each compatible gripper: the model compiles, and its drives hold the home posture.

    The exit code is 3 if a file is not valid, and 5 if a check fails.

    Example: yamsim robots check yam_v1
    """
    session_opener.disable_gl()

    from yamsim_cli.robot_catalog import check_robot, require_checked

    found = check_robot(name, _locations_with_data(data))
    report = {"ok": all(one["ok"] is not False for one in found), "grippers": found}
    print_report(report, lambda: _check_table(found), json)
    require_checked(name, found)


def _check_table(found: Sequence[Mapping[str, Any]]) -> ItemTable:
    table = ItemTable(["gripper", "", "found"], numbers_from=3)
    for one in found:
        table.add_row(one["gripper"], _CHECK_RESULT_LABELS[one["ok"]], one["detail"])
    return table


def _locations_with_data(data: Path | None) -> Locations:
    where = session_opener.find_locations()
    return where if data is None else replace(where, data=(data, *where.data))


def _robot_row(item: Mapping[str, Any]) -> list[str]:
    goes_with = ", ".join(item["goes_with"])
    source = "NOT VALID, see below" if "fault" in item else item["source"] or ""
    return [item["kind"], item["name"], _family_and_revision(item), goes_with, source, _mesh_status(item)]


def _family_and_revision(item: Mapping[str, Any]) -> str:
    if item.get("family") is None:
        return ""
    return f"{item['family']} {item['revision']}" + (" (newest)" if item["newest"] else "")


def _mesh_status(item: Mapping[str, Any]) -> str:
    missing = [name for name, here in item["meshes"].items() if not here]
    if not item["meshes"]:
        return "none"
    return f"yamsim assets fetch {' '.join(missing)}" if missing else "present"


def _mesh_states(meshes: Mapping[str, bool]) -> str:
    return ", ".join(f"{name}: {'present' if here else 'missing'}" for name, here in meshes.items()) or "none"
