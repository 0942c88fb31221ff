"""Ctrl-C and SIGTERM during the start of a command end it as cleanly as later.

`yamsim view` ends with 0, since a signal is how a viewer ends; any other command with 130 and one line.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]

# Runs `python -m yamsim_cli ARGS`, and sends a signal to itself when a given module is looked for.
SIGNALLED_AT = """
import os, runpy, sys
number, module, *args = sys.argv[1:]

class Sender:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name == module:
            sys.meta_path.remove(Sender)
            os.kill(os.getpid(), int(number))

sys.meta_path.insert(0, Sender)
sys.argv = ["yamsim", *args]
runpy.run_module("yamsim_cli", run_name="__main__")
"""


def run(code: str, *args: str, path: Path | None = None) -> tuple[int, str, list[str]]:
    """Return exit code, stdout, and stderr without the note on missing meshes."""
    places = [str(place) for place in (path, REPOSITORY) if place]
    done = subprocess.run(
        [sys.executable, "-c", code, *args],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(places)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    return done.returncode, done.stdout, [line for line in done.stderr.splitlines() if "The meshes of" not in line]


@pytest.mark.parametrize(
    ("module", "number"),
    [
        ("yamsim_cli.main", signal.SIGINT),
        ("typer", signal.SIGTERM),
        ("yamsim_cli.commands.view", signal.SIGINT),
        pytest.param("mujoco._specs", signal.SIGTERM, marks=pytest.mark.slow),
        pytest.param("yamsim_cli.viewers.rig_page", signal.SIGINT, marks=pytest.mark.slow),
        pytest.param("viser", signal.SIGTERM, marks=pytest.mark.slow),
    ],
)
def test_a_viewer_that_is_still_starting_ends_with_0(module: str, number: signal.Signals) -> None:
    pytest.importorskip("viser", reason="yamsim[view] is not installed")
    args = (str(int(number)), module, "view", "--web", "--port", "0")
    assert run(SIGNALLED_AT, *args) == (0, "", [])


@pytest.mark.parametrize("module", ["typer", "yamsim_cli.commands.trials", "mujoco._specs"])
def test_any_other_command_ends_with_130_and_one_line(module: str) -> None:
    args = (str(int(signal.SIGINT)), module, "pickplace", "batch", "--n", "1", "--workers", "1")
    code, out, (line,) = run(SIGNALLED_AT, *args)
    assert (code, out) == (130, "")
    assert line.startswith("yamsim: interrupted")


def test_an_import_is_not_broken_off(tmp_path: Path) -> None:
    """A library might do without an extension module whose import was interrupted."""
    (tmp_path / "slow.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGINT)\nwhole = True\n")
    code = """
import time
from yamsim_cli.terminal.signals import raise_signals
raise_signals()
try:
    import slow
    time.sleep(30)
except KeyboardInterrupt:
    print(slow.whole)
"""
    assert run(code, path=tmp_path) == (0, "True\n", [])
