from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from yamsim_cli import __version__
from yamsim_cli.core.errors import ConfigError, ResourceError, UsageError, file_size
from yamsim_cli.flags.output_files import Overwrite, require_unused_paths
from yamsim_cli.flags.session_options import Json, Offline, session_opener
from yamsim_cli.terminal.console import print_json, print_line, print_note, print_report, progress_bar
from yamsim_cli.terminal.tables import ItemTable

if TYPE_CHECKING:
    from yamsim_cli.core.scene.assets import AssetLock, AssetSet, AssetStore, ReducedSet
    from yamsim_cli.mesh_download.fetch import FetchReport
    from yamsim_cli.objects.building import ImportOptions
    from yamsim_cli.objects.certify.certify import CertificationResult
    from yamsim_cli.objects.importing.file_import import ImportedObjectFile
    from yamsim_cli.objects.importing.ycb_import import ImportedYcbObject
    from yamsim_cli.objects.readers.object_reader import UnitOptions

app = typer.Typer(
    help="List and fetch the robot and object meshes, and import and certify objects.", no_args_is_help=True
)

_CHECK_RESULT_LABELS = {True: "passed", False: "FAILED", None: "not checked"}


@app.command("list")
def list_assets(json: Json = False) -> None:
    """List every mesh file with its set, size, state and path, and the state of each object's certificate.

    Example: yamsim assets list --json
    """
    from yamsim_cli.terminal.console import print_table

    lock, store = _load_lock_and_open_store()
    items = [item for assets in lock.sets.values() for item in _file_entries(assets, store)]
    things = _certificate_entries(lock)
    if json:
        print_json({"items": items, "things": things})
    else:
        print_table(_print_entry_table(items, ("name", "set", "status", "size"), 3))
        print_table(_print_entry_table(things, ("name", "certificate", "failed"), 3))
        for assets in lock.sets.values():
            print_line(f"{assets.name} ({assets.license}): {store.file_states(assets)[0].path.parent}")


@app.command()
def fetch(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAMES]...", help="Sets to fetch.  [default: the sets of shipped rigs, tasks and objects]"
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Fetch the mesh sets that are missing or damaged, verify and reduce them, and keep them for offline use.

    Example: yamsim assets fetch ycb
    """
    from yamsim_cli.terminal.console import print_table

    lock, store = _load_lock_and_open_store()
    report, reduced = _fetch_with_progress(lock, store, names or [])
    items = [
        {
            "name": fetched.name,
            "files": len(lock.sets[fetched.name].files),
            "size": lock.sets[fetched.name].total_bytes,
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
        print_table(_print_entry_table(items, ("name", "source", "files", "size", "faces", "reduced_faces"), 2))
        for item in items:
            print_line(f"{item['name']}: {item['path']}")


def _load_lock_and_open_store() -> tuple[AssetLock, AssetStore]:
    from yamsim_cli.core.scene.assets import AssetStore, load_lock

    locations = session_opener.find_locations()
    return load_lock(locations), AssetStore(locations.assets)


def _file_entries(assets: AssetSet, store: AssetStore) -> Sequence[Mapping[str, object]]:
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
        for state in store.file_states(assets)
    ]


def _certificate_entries(lock: AssetLock) -> list[dict[str, Any]]:
    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.objects.object_config import ObjectConfig
    from yamsim_cli.core.scene.certificates import find_certificate

    where = session_opener.find_locations()
    found = list[dict[str, Any]]()
    for name in where.config_names("objects"):
        try:
            item = load_config(ObjectConfig, "objects", name, where)
        except ConfigError as error:
            found.append({"name": name, "certificate": f"its config is not valid: {error}", "failed": [], "path": None})
            continue
        state = find_certificate(where.assets, item, lock)
        path = state.path and str(state.path)
        found.append({"name": name, "certificate": state.status.value, "failed": list(state.failed), "path": path})
    return found


def _fetch_with_progress(
    lock: AssetLock, store: AssetStore, names: list[str]
) -> tuple[FetchReport, dict[str, ReducedSet]]:
    from yamsim_cli.core.scene.assets import make_reduced
    from yamsim_cli.mesh_download.fetch import default_sources, fetch
    from yamsim_cli.terminal.fetch_bar import fetch_bar

    with fetch_bar() as advance:
        report = fetch(lock, names, store, default_sources(lock), advance)
        reduced: dict[str, ReducedSet] = {}
        for fetched in report.sets:
            assets = lock.sets[fetched.name]

            def show_reduction_progress(done: int, total: int, label: str = f"{assets.name}: reducing") -> None:
                advance(label, done, total, f"{done} of {total} files")

            try:
                reduced[assets.name] = make_reduced(
                    store, assets, fetched.directory, lock.notices[assets.notice], show_reduction_progress
                )
            except ResourceError as error:
                print_note(f"No reduced meshes of {assets.name}: {error}")
    return report, reduced


def _print_entry_table(items: Sequence[Mapping[str, Any]], columns: tuple[str, ...], numbers_from: int) -> ItemTable:
    table = ItemTable([column.replace("_", " ") for column in columns], numbers_from=numbers_from)
    for item in items:
        table.add_row(*(_cell_text(column, item[column]) for column in columns))
    return table


def _cell_text(column: str, value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, list):
        return ", ".join(value)
    if column == "size":
        return file_size(value)
    return f"{value:,}" if isinstance(value, int) else str(value)


@app.command("certify")
def certify_object(
    thing: Annotated[str, typer.Argument(metavar="THING", help="An object: a name from configs/objects/ or a file.")],
    html: Annotated[Path | None, typer.Option(help="Also write a page with pictures of every check.")] = None,
    overwrite: Overwrite = False,
    offline: Offline = False,
    json: Json = False,
) -> None:
    """Check an object's size, surfaces, mass, rest, drops, hollow, joints and grasp. Exit code 4 if a check fails.

    Example: yamsim assets certify kitchen_bowl --html bowl.html
    """
    if html:
        require_unused_paths("--html", html, overwrite=overwrite)
        session_opener.choose_gl_backend(session_opener.find_locations())
    else:
        session_opener.disable_gl()
    certified = _certify_and_store(thing)
    found = certified.to_json_data()
    if html:
        from yamsim_cli.objects.certify.certificate_page import write_certificate_page

        write_certificate_page(certified, html)
        found["html"] = str(html)
    print_report(found, lambda: _certificate_table(found["checks"]), json)
    if html and not json:
        print_note(f"The page is in {html}.")
    if not certified.ok:
        raise ResourceError(_failure_text(certified))


def _certificate_table(checks: Sequence[Mapping[str, Any]]) -> ItemTable:
    table = ItemTable(["check", "", "figures"], numbers_from=3)
    for check in checks:
        figures = ", ".join(f"{name} {value}" for name, value in check["figures"].items())
        table.add_row(
            check["code"], _CHECK_RESULT_LABELS[check["ok"]], "; ".join(filter(None, (check["note"], figures)))
        )
    return table


def _certify_and_store(thing: str) -> CertificationResult:
    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.objects.object_config import ObjectConfig
    from yamsim_cli.core.scene.assets import load_lock
    from yamsim_cli.core.scene.certificates import store_certificate
    from yamsim_cli.objects.certify.certify import run_object_checks

    where = session_opener.find_locations()
    item = load_config(ObjectConfig, "objects", thing, where)
    where = session_opener.with_mesh_folders(where, item.mesh_sets)
    with progress_bar(f"certifying {item.name}", "checks") as advance:
        certified = run_object_checks(item, where.meshes, where, advance)
    made_with = {"yamsim": __version__, "mujoco": version("mujoco")}
    store_certificate(where.assets, item, load_lock(where), certified.to_json_data(), made_with)
    return certified


def _failure_text(certified: CertificationResult) -> str:
    from yamsim_cli.objects.certify.certify import CHECKS

    code = certified.failed_codes[0]
    check, outcome = CHECKS[code], certified.outcomes[code]
    more = f" (and {len(certified.failed_codes) - 1} more)" if len(certified.failed_codes) > 1 else ""
    return f"{certified.subject.item.name}: {check.title}: {outcome.note} [{code}]{more}; {check.advice}"


@app.command("import")
def import_object(
    source: Annotated[
        str,
        typer.Argument(
            metavar="YCB_ID|FILE",
            help="A YCB object such as 013_apple, or a file: .sdf .glb .gltf .obj .stl .ply .dae .urdf .xml (MJCF).",
        ),
    ],
    name: Annotated[str | None, typer.Option(help="Name of the object.  [default: the name of the file]")] = None,
    mass: Annotated[
        float | None, typer.Option(min=5e-4, max=50, help="Mass in kg.  [default: the published mass, or the file's]")
    ] = None,
    density: Annotated[
        float | None, typer.Option(min=1, max=25_000, help="Uniform density in kg/m3, in place of a mass.")
    ] = None,
    unit: Annotated[
        Literal["m", "cm", "mm", "in"] | None, typer.Option(help="Length unit, for a file that gives none.")
    ] = None,
    up: Annotated[Literal["x", "y", "z"] | None, typer.Option(help="Upward axis, for a file that gives none.")] = None,
    scale: Annotated[float, typer.Option(min=1e-6, max=1e6, help="Factor of all lengths.")] = 1.0,
    collision: Annotated[
        Literal["auto", "primitives", "decompose", "sdf", "hull"],
        typer.Option(
            help="Collision geometry; auto: the file's own, or primitives within 1.5 mm, or else convex parts."
        ),
    ] = "auto",
    base: Annotated[
        Literal["free", "fixed"] | None,
        typer.Option(help="Whether the object's base can move.  [default: as in the file]"),
    ] = None,
    friction: Annotated[float | None, typer.Option(min=0.01, max=5, help="Sliding friction.")] = None,
    out: Annotated[
        Path | None, typer.Option(help="The YAML file to write.  [default: $YAMSIM_DATA_DIR/configs/objects/NAME.yaml]")
    ] = None,
    certify: Annotated[
        bool, typer.Option("--certify/--no-certify", help="Check the object in physics, as `assets certify` does.")
    ] = True,
    json: Json = False,
) -> None:
    """Make an object's config: visual meshes, collision shapes, inertia and grasps. Exit code 4 if a check fails.

    Example: yamsim assets import mug.stl --name my_mug --mass 0.3 --out my_mug.yaml
    """
    from yamsim_cli.objects.readers import OBJECT_SUFFIXES

    if Path(source).suffix.lower() not in OBJECT_SUFFIXES:
        if name is not None:
            raise UsageError("--name is for your own files; a YCB object keeps its name")
        item, lines = _import_ycb(source, mass, out)
    else:
        if mass is not None and density is not None:
            raise UsageError("--mass and --density exclude each other; give one")
        from yamsim_cli.objects.building import ImportOptions
        from yamsim_cli.objects.importing.file_import import object_name_of
        from yamsim_cli.objects.readers.object_reader import UnitOptions

        file = Path(source)
        options = ImportOptions(name or object_name_of(file), mass, density, collision, base, friction)
        item, lines = _import_file(file, UnitOptions(unit, up, scale), options, out)
    certified = None
    if certify:
        session_opener.disable_gl()
        certified = _certify_and_store(item["path"])
    item["certificate"] = certified and {"ok": certified.ok, "failed": list(certified.failed_codes)}
    if json:
        print_json({"items": [item]})
    else:
        for line in lines:
            print_line(line)
    if certified is not None:
        if not certified.ok:
            raise ResourceError(f"{item['path']} is written, but its certificate failed: {_failure_text(certified)}")
        print_note("Certificate: passed")


def _import_ycb(name: str, mass: float | None, out: Path | None) -> tuple[dict[str, Any], list[str]]:
    from yamsim_cli.objects.importing.ycb_import import import_ycb

    made = import_ycb(name, session_opener.find_locations(), None if mass is None else mass * 1000, out)
    item = _ycb_item(made)
    held = f"{item['width_mm']:g} mm wide where it is held" if item["width_mm"] else "a vessel to put things in or on"
    return item, [
        f"{item['path']}: {', '.join(item['primitives'])}; {item['rms_mm']:.1f} mm off the scan (rms), 99 % within "
        f"{item['p99_mm']:.1f} mm",
        f"{item['name']} is {held}; check the file: its colour and friction are guesses",
    ]


def _import_file(
    file: Path, units: UnitOptions, options: ImportOptions, out: Path | None
) -> tuple[dict[str, Any], list[str]]:
    """Notes about guesses go to stderr."""
    from yamsim_cli.objects.importing.file_import import import_file

    with progress_bar(f"importing {file.name}", "%") as advance:
        imported = import_file(
            file, units, options, session_opener.find_locations(), out, lambda done: advance(round(100 * done), 100)
        )
    made = imported.built_object
    for text in made.notes:
        print_note(f"{file.name}: {text}")
    if made.mass_is_guessed:
        kind = "a solid" if made.is_closed else "a sheet 2 mm thick, because its surface is not closed,"
        print_note(
            f"{file.name}: its mass of {made.mass * 1000:.3g} g is a guess, for {kind} of 1,000 kg/m3: give --mass "
            "or --density"
        )
    item = _file_item(imported)
    collision = item["collision"]
    near = "" if collision["p99_mm"] is None else f", 99 % within {collision['p99_mm']:.1f} mm of the surface"
    held = "no part of it fits between the fingers" if item["width_mm"] is None else f"{item['width_mm']:g} mm wide"
    moves = f"; moves: {', '.join(item['links'])}" if item["links"] else ""
    return item, [
        f"{item['path']}: collision geometry {collision['kind']} ({collision['parts']} parts{near}), "
        f"{item['textures']} of {item['meshes']} meshes with a picture{moves}",
        f"{item['name']}: {item['mass_kg'] * 1000:.4g} g, {held} where it is held",
    ]


def _ycb_item(made: ImportedYcbObject) -> dict[str, Any]:
    fit, data = made.description.fit, made.description.data
    return {
        "name": data["name"],
        "path": str(made.path),
        "primitives": [part.type for part in fit.parts],
        "rms_mm": round(fit.rms * 1000, 3),
        "p99_mm": round(fit.p99 * 1000, 3),
        "width_mm": round(2000 * data["grasp"]["opening"], 1) if "grasp" in data else None,
        "vessel": "grasp" not in data,
    }


def _file_item(imported: ImportedObjectFile) -> dict[str, Any]:
    config, made = imported.config, imported.built_object
    fits = [part.fit for part in made.collision if part.fit is not None]
    return {
        "name": config.name,
        "path": str(imported.path),
        "set": config.mesh.set,
        "mass_kg": round(made.mass, 6),
        "mass_is_a_guess": made.mass_is_guessed,
        "closed": made.is_closed,
        "collision": {
            "kind": made.collision[0].kind,
            "parts": sum(len(part.parts) for part in made.collision),
            "p99_mm": round(1000 * max(fit.p99 for fit in fits), 3) if fits else None,
        },
        "meshes": len(config.all_meshes),
        "textures": sum(mesh.texture is not None for mesh in config.all_meshes),
        "links": [link.name for link in config.links],
        "width_mm": None if config.grasp is None else round(2000 * config.grasp.opening, 1),
        "carries": config.can_support,
    }
