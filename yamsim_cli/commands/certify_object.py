"""`yamsim assets certify`: look whether a thing behaves as a thing does."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from yamsim_cli import __version__
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.flags.outputs import Overwrite, require_free
from yamsim_cli.flags.session import Json, Offline, opener
from yamsim_cli.terminal.console import note, print_json, print_table, progress_bar
from yamsim_cli.terminal.tables import Listing

if TYPE_CHECKING:
    from yamsim_cli.core.certify.run import Certified

_WORDS = {True: "passed", False: "FAILED", None: "not checked"}


def certify_object(
    thing: Annotated[str, typer.Argument(metavar="THING", help="An object: a name from configs/objects/ or a file.")],
    html: Annotated[Path | None, typer.Option(help="Also write a page with pictures of every check.")] = None,
    overwrite: Overwrite = False,
    offline: Offline = False,
    json: Json = False,
) -> None:
    """Check a thing's size, surfaces, weight, rest, falls, hollow, joints and grasp. Exit code 4 where one fails.

    Example: yamsim assets certify kitchen_bowl --html bowl.html
    """
    if html:
        require_free("--html", html, overwrite=overwrite)
        opener.use_gl(opener.locations())
    else:
        opener.skip_gl()
    certified = certify_named(thing)
    found = certified.plain()
    if html:
        from yamsim_cli.core.certify.report import write_page

        write_page(certified, html)
        found["html"] = str(html)
    if json:
        print_json(found)
    else:
        table = Listing(["check", "", "figures"], numbers_from=3)
        for check in found["checks"]:
            figures = ", ".join(f"{name} {value}" for name, value in check["figures"].items())
            table.add_row(check["code"], _WORDS[check["ok"]], "; ".join(filter(None, (check["note"], figures))))
        print_table(table)
        if html:
            note(f"The page is in {html}.")
    if not certified.ok:
        raise ResourceError(failure(certified))


def certify_named(thing: str) -> Certified:
    """Certify an object by its name or file, and keep what was found."""
    from yamsim_cli.core.assets import load_lock
    from yamsim_cli.core.certify.run import certify
    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.things.thing import ObjectConfig
    from yamsim_cli.core.things.certificates import store_certificate

    where = opener.locations()
    item = load_config(ObjectConfig, "objects", thing, where)
    where = opener.find_meshes(where, item.mesh_sets)
    with progress_bar(f"certifying {item.name}", "checks") as advance:
        certified = certify(item, where.meshes, where, advance)
    made_with = {"yamsim": __version__, "mujoco": version("mujoco")}
    store_certificate(where.assets, item, load_lock(where), certified.plain(), made_with)
    return certified


def failure(certified: Certified) -> str:
    """One line on the first check that failed, and how many more did."""
    from yamsim_cli.core.certify.run import CHECKS

    code = certified.failed[0]
    check, outcome = CHECKS[code], certified.outcomes[code]
    more = f" (and {len(certified.failed) - 1} more)" if len(certified.failed) > 1 else ""
    return f"{certified.subject.item.name}: {check.title}: {outcome.note} [{code}]{more}; {check.advice}"


def brief(certified: Certified) -> dict[str, Any]:
    """What an import says of it."""
    return {"ok": certified.ok, "failed": list(certified.failed)}
