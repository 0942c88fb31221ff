"""`yamsim assets`: the meshes that yamsim uses but does not ship."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from yamsim_cli.core.errors import ConfigError, ResourceError
from yamsim_cli.terminal.tables import Listing, file_size, listing

from .certify_object import certify_object
from .import_object import import_object

if TYPE_CHECKING:
    from yamsim_cli.core.assets import AssetLock, AssetSet, AssetStore, FetchReport, ReducedSet

app = typer.Typer(
    help="List and fetch the robot and object meshes, and import and certify objects.", no_args_is_help=True
)
app.command("import")(import_object)
app.command("certify")(certify_object)

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]


@app.command("list")
def list_assets(json: Json = False) -> None:
    """List every mesh file with its set, size, state and place, and how each object's certificate stands.

    Example: yamsim assets list --json
    """
    from yamsim_cli.terminal.console import print_json, print_line, print_table

    lock, store = _open()
    items = [item for assets in lock.sets.values() for item in _files(assets, store)]
    things = _things(lock)
    if json:
        print_json({"items": items, "things": things})
    else:
        print_table(_table(items, ("name", "set", "status", "size"), 3))
        print_table(_table(things, ("name", "certificate", "failed"), 3))
        for assets in lock.sets.values():
            print_line(f"{assets.name} ({assets.license}): {store.status(assets)[0].path.parent}")


@app.command()
def fetch(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAMES]...", help="Sets to fetch.  [default: those that shipped rigs, tasks and objects show]"
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Fetch the mesh sets that are missing or damaged, verify and reduce them, and keep them for offline use.

    Example: yamsim assets fetch ycb
    """
    from yamsim_cli.terminal.console import print_json, print_line, print_table

    lock, store = _open()
    report, reduced = _fetch_with_progress(lock, store, names or [])
    items = [
        {
            "name": fetched.name,
            "files": len(lock.sets[fetched.name].files),
            "size": lock.sets[fetched.name].size,
            "license": lock.sets[fetched.name].license,
            "source": fetched.source,
            "path": str(fetched.directory),
            "faces": made and made.source_faces,
            "reduced_faces": made and made.faces,
            "reduced_path": made and str(made.directory),
        }
        for fetched in report.sets
        for made in (reduced.get(fetched.name),)
    ]
    if json:
        print_json({"items": items})
    else:
        print_table(_table(items, ("name", "source", "files", "size", "faces", "reduced_faces"), 2))
        for item in items:
            print_line(f"{item['name']}: {item['path']}")


def _open() -> tuple[AssetLock, AssetStore]:
    from yamsim_cli.core.assets import AssetStore, load_lock
    from yamsim_cli.core.resources import Locations

    locations = Locations.find(os.environ)
    return load_lock(locations), AssetStore(locations.assets)


def _files(assets: AssetSet, store: AssetStore) -> Sequence[Mapping[str, object]]:
    return [
        {
            "name": state.name,
            "set": assets.name,
            "size": assets.files[state.name].size,
            "sha256": assets.files[state.name].sha256,
            "status": state.status.value,
            "license": assets.license,
            "on_demand": assets.on_demand,
            "path": str(state.path),
        }
        for state in store.status(assets)
    ]


def _things(lock: AssetLock) -> list[dict[str, Any]]:
    """Every object there is a config of, and how it stands with its certificate."""
    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.things.thing import ObjectConfig
    from yamsim_cli.core.resources import Locations
    from yamsim_cli.core.things.certificates import find_certificate

    where = Locations.find(os.environ)
    found = list[dict[str, Any]]()
    for name in where.config_names("objects"):
        try:
            item = load_config(ObjectConfig, "objects", name, where)
        except ConfigError as error:
            found.append({"name": name, "certificate": f"its config is not valid: {error}", "failed": [], "path": None})
            continue
        stands = find_certificate(where.assets, item, lock)
        path = stands.path and str(stands.path)
        found.append({"name": name, "certificate": stands.standing.value, "failed": list(stands.failed), "path": path})
    return found


def _fetch_with_progress(
    lock: AssetLock, store: AssetStore, names: list[str]
) -> tuple[FetchReport, dict[str, ReducedSet]]:
    """What was fetched, and set -> its reduced meshes, as far as they could be made."""
    from yamsim_cli.core.assets import default_sources, fetch, make_reduced
    from yamsim_cli.terminal.console import note
    from yamsim_cli.terminal.fetch_bar import fetch_bar

    with fetch_bar() as advance:
        report = fetch(lock, names, store, default_sources(lock), advance)
        reduced: dict[str, ReducedSet] = {}
        for fetched in report.sets:
            assets = lock.sets[fetched.name]

            def made(done: int, total: int, label: str = f"{assets.name}: reducing") -> None:
                advance(label, done, total, f"{done} of {total} files")

            try:
                reduced[assets.name] = make_reduced(store, assets, fetched.directory, lock.notices[assets.notice], made)
            except ResourceError as error:
                note(f"No reduced meshes of {assets.name}: {error}")
    return report, reduced


def _table(items: Sequence[Mapping[str, Any]], columns: tuple[str, ...], numbers_from: int) -> Listing:
    table = listing([column.replace("_", " ") for column in columns], numbers_from=numbers_from)
    for item in items:
        table.add_row(*(_shown(column, item[column]) for column in columns))
    return table


def _shown(column: str, value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, list):
        return ", ".join(value)
    if column == "size":
        return file_size(value)
    return f"{value:,}" if isinstance(value, int) else str(value)
