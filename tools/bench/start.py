"""Start-up: seconds from the prompt to the first published episode, and of commands that read little.

    python -m tools.bench.start [--against CHECKOUT] [--rounds 5] [--jobs NAME ...] [--json FILE]

`--against` measures another checkout in alternation, with the same Python. Wall-clock time depends on what else runs on
the machine, CPU time much less; it includes all processes that the command starts. A second table has the CPU time of
the parts of a start: the command and the test of OpenGL run beside the imports of the worker.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from yamsim_cli.core.dataset.dataset_paths import episode_name

_HERE = Path(__file__).resolve().parents[2]
_POLL_SECONDS = 0.005  # s, between looks at the dataset
_TIME_LIMIT = 300.0  # s, of one command

# Job -> arguments of yamsim; "{out}" is a new directory, and "{dataset}" is one with an episode. Small images leave the
# start and the physics.
JOBS = {
    "episode": ("record", "--n", "1", "--out", "{out}"),
    "small episode": ("record", "--n", "1", "--size", "32x24", "--out", "{out}"),
    "help": ("--help",),
    "summarize": ("summarize", "{dataset}"),
}


# Programs that print CPU seconds of parts of a start: of this process, of its children, and of a worker.
_COMMAND_PROGRAM = """
import json, resource, time
import yamsim_cli.main
from yamsim_cli.flags.session_options import session_opener
session_opener.open("default")
from yamsim_cli.recording.recorder import record
probe = resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps({"command": time.process_time(), "test of OpenGL": probe.ru_utime + probe.ru_stime}))
"""
_WORKER_PROGRAM = """
import json, time
import mink, yamsim_cli.core.episode.runner
imports = time.process_time()
from yamsim_cli.flags.session_options import session_opener
from yamsim_cli.core.scene.build import with_mesh_descriptions
session = with_mesh_descriptions(session_opener.open("default"))
began = time.process_time()
yamsim_cli.core.episode.runner.AttemptRunner(session, render=True)
print(json.dumps({"worker: imports": imports, "worker: scene and planner": time.process_time() - began}))
"""


@dataclass(frozen=True)
class Run:
    """One run of a command: s of wall-clock time until its result, and s of CPU time until its end."""

    wall: float
    cpu: float


def run_once(checkout: Path, arguments: tuple[str, ...], dataset: Path) -> Run:
    """Run yamsim from a checkout. The result of a recording is its first episode, else the end of the command.

    Raises:
        RuntimeError: the command failed, or exceeded its time limit.
    """
    with tempfile.TemporaryDirectory(prefix="yamsim-start-") as folder:
        out = Path(folder) / "dataset"
        command = [part.format(out=out, dataset=dataset) for part in arguments]
        errors = Path(folder) / "errors"
        began = time.perf_counter()
        with errors.open("w") as stderr:
            process = subprocess.Popen(
                [sys.executable, "-m", "yamsim_cli", *command],
                env=os.environ | {"PYTHONPATH": str(checkout)},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=stderr,
            )
            published: float | None = None
            while True:
                if published is None and (out / episode_name(0)).exists():
                    published = time.perf_counter() - began
                ended, status, usage = os.wait4(process.pid, os.WNOHANG)
                if ended:
                    break
                if time.perf_counter() - began > _TIME_LIMIT:
                    process.kill()
                time.sleep(_POLL_SECONDS)
        wall = time.perf_counter() - began
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise RuntimeError(f"yamsim {' '.join(command)} in {checkout} failed: {errors.read_text().strip()}")
        return Run(wall if published is None else published, usage.ru_utime + usage.ru_stime)


def measure_parts(checkouts: dict[str, Path], rounds: int) -> dict[str, dict[str, list[float]]]:
    """Return part -> checkout -> CPU seconds; checkouts alternate."""
    found: dict[str, dict[str, list[float]]] = {}
    for _ in range(rounds):
        for name, checkout in checkouts.items():
            for program in (_COMMAND_PROGRAM, _WORKER_PROGRAM):
                environment = os.environ | {"PYTHONPATH": str(checkout)}
                printed = subprocess.check_output([sys.executable, "-c", program], env=environment, text=True)
                for part, seconds in json.loads(printed).items():
                    found.setdefault(part, {each: [] for each in checkouts})[name].append(seconds)
    return found


def measure(checkouts: dict[str, Path], rounds: int, jobs: list[str]) -> dict[str, dict[str, list[Run]]]:
    """Return job -> checkout -> runs. Checkouts alternate, and a first round warms up."""
    with tempfile.TemporaryDirectory(prefix="yamsim-start-") as folder:
        dataset = Path(folder) / "dataset"
        found: dict[str, dict[str, list[Run]]] = {job: {name: [] for name in checkouts} for job in jobs}
        run_once(_HERE, ("record", "--n", "1", "--size", "32x24", "--out", str(dataset)), dataset)
        for number in range(rounds + 1):
            for job in jobs:
                for name, checkout in checkouts.items():
                    run = run_once(checkout, JOBS[job], dataset)
                    if number:
                        found[job][name].append(run)
        return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--against", type=Path, help="root of another checkout")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--jobs", nargs="*", choices=list(JOBS), default=list(JOBS))
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    checkouts = {"this checkout": _HERE}
    if arguments.against is not None:
        checkouts = {"the other": arguments.against.resolve(), **checkouts}
    found = measure(checkouts, arguments.rounds, arguments.jobs)
    table = Table(title=f"Median (lowest) of {arguments.rounds} rounds, s; load {os.getloadavg()[0]:.1f}")
    for column in ("job", "checkout", "wall", "CPU"):
        table.add_column(column, justify="right" if column in ("wall", "CPU") else "left")
    for job, runs in found.items():
        for name, each in runs.items():
            walls, cpus = [run.wall for run in each], [run.cpu for run in each]
            table.add_row(
                job,
                name,
                f"{statistics.median(walls):.2f} ({min(walls):.2f})",
                f"{statistics.median(cpus):.2f} ({min(cpus):.2f})",
            )
    console = Console(width=110)
    console.print(table)
    parts = measure_parts(checkouts, arguments.rounds)
    parts_table = Table(title="Parts of a start, median CPU seconds")
    for column in ("part", *checkouts):
        parts_table.add_column(column)
    for part, seconds_of in parts.items():
        parts_table.add_row(part, *(f"{statistics.median(seconds):.2f}" for seconds in seconds_of.values()))
    console.print(parts_table)
    if arguments.json:
        document = {
            job: {name: [[run.wall, run.cpu] for run in each] for name, each in runs.items()}
            for job, runs in found.items()
        }
        arguments.json.write_text(json.dumps(document, indent=2) + "\n")


if __name__ == "__main__":
    main()
