from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from yamsim_cli.core.errors import ResourceError
from yamsim_cli.flags.session_options import Json, session_opener
from yamsim_cli.terminal.console import print_json, print_line, print_wrapped_text

if TYPE_CHECKING:
    from yamsim_cli.doctor import HealthCheck

_HEALTH_STYLES = {"ok": "green", "warning": "yellow", "fault": "bold red"}


def doctor(
    out: Annotated[Path, typer.Option(help="Directory of future datasets.")] = Path("dataset"), json: Json = False
) -> None:
    """Check OpenGL, meshes, the disk, memory and packages, and show a fix for each fault.

    Each OpenGL backend is tried in a separate process with a time limit. Three synthetic episodes are written to the
    disk and removed. Nothing else is changed. The exit code is 4 if there is a fault.

    Example: yamsim doctor --out /data/episodes
    """
    from yamsim_cli.doctor import failed_checks, run_health_checks

    checks = run_health_checks(
        os.environ, session_opener.find_locations(), out, (lambda check: None) if json else _print
    )
    found = failed_checks(checks)
    if json:
        print_json({"ok": not found, "checks": [asdict(check) for check in checks]})
    if found:
        first = found[0]
        more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
        raise ResourceError(f"{first.name}: {first.detail}{more}; {first.fix}")
    if not json:
        print_line("No problems found.")


def _print(check: HealthCheck) -> None:
    print_wrapped_text(f"{check.health:8}", f"{check.name}: {check.detail}", _HEALTH_STYLES[check.health])
    if check.fix:
        print_line(f"{'':8}  -> {check.fix}")
