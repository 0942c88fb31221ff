"""Start a program of the maker's station on the buses and cameras of a running `yamsim serve-robot`."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import NoReturn

import yamsim_cli

# First on the program's PYTHONPATH: `pyrealsense2`. Its `bin` is first on the program's PATH: `ip`.
_ADAPTERS = Path(__file__).with_name("adapters")


def program_environment(folder: Path | None) -> dict[str, str]:
    """Return the variables that a program needs besides those of this process.

    Args:
        folder: value of `serve-robot --folder`, if it has one.

    Raises:
        SystemExit: no `serve-robot` runs there; with the message and the exit code of `yamsim can-run`.
    """
    where = ["--folder", str(folder)] if folder else []
    command = [sys.executable, "-m", "yamsim_cli", "can-run", *where, "--json", "--", "ip"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.stderr.write(done.stderr)
        raise SystemExit(done.returncode)
    found: dict[str, str] = json.loads(done.stdout)["environ"]
    found["PYTHONPATH"] = os.pathsep.join([str(_ADAPTERS), found["PYTHONPATH"]])
    system_path = os.environ.get("PATH", os.defpath)
    return {
        **found,
        "PATH": os.pathsep.join([str(_ADAPTERS / "bin"), system_path]),
        "YAMSIM_SYSTEM_PATH": system_path,
        "YAMSIM_PACKAGES": str(Path(yamsim_cli.__file__).parents[1]),
    }


def main() -> NoReturn:
    """Run the command line `yamsim-maker [--folder DIRECTORY] PROGRAM...`."""
    parser = argparse.ArgumentParser(
        prog="yamsim-maker",
        description="Run a program of the maker's yam-abc-reproduce on the station of `yamsim serve-robot --cameras`.",
    )
    parser.add_argument("--folder", type=Path, help="value of `serve-robot --folder`, if it has one")
    parser.add_argument("program", nargs=argparse.REMAINDER, metavar="PROGRAM...", help="with its arguments")
    given = parser.parse_args()
    if not given.program:
        parser.error("give a program, such as: yamsim-maker yam-abc-gui --station station.yaml")
    environ = {**os.environ, **program_environment(given.folder)}
    try:
        os.execvpe(given.program[0], given.program, environ)
    except OSError as error:
        sys.stderr.write(f"{given.program[0]}: cannot be run: {error.strerror}\n")
        raise SystemExit(2) from error
