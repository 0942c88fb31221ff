"""Frames and episodes per core-second, beside robosuite (Lift) and gym-aloha (TransferCube).

    python -m tools.bench.peers [--robosuite PYTHON] [--gym-aloha PYTHON] [--images large small] [--frames 20]

`PYTHON` is the interpreter of a virtual environment that has the peer. All run in alternation, each in a process with
one rendering thread. An episode is 85 frames, as of yamsim's `pickplace`: 5.4 s of simulated time, with the same
cameras and sizes. yamsim's part without images includes planning by its expert; the peers' arms move at random. Images
are read back, and neither encoded nor written.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

_PROGRAMS = Path(__file__).parent / "peer_programs"
_ROOT = Path(__file__).resolve().parents[2]
_FRAMES_PER_EPISODE = 85  # of yamsim's `pickplace`, 5.4 s
_FRAMES_PER_SECOND = 15.625  # Hz, of yamsim's recordings
_TIME_LIMIT = 600.0  # s, of one program


@dataclass(frozen=True)
class Work:
    """Cameras and size, px, of the images in each frame."""

    cameras: int
    width: int
    height: int

    def __str__(self) -> str:
        return f"{self.cameras} x {self.width}x{self.height}"


_WORKS = {"large": Work(2, 640, 480), "small": Work(3, 224, 168)}


@dataclass(frozen=True)
class Contestant:
    """A program, the interpreter that runs it, the package that the interpreter must have, and its settings."""

    name: str
    program: str
    python: str
    package: str
    settings: dict[str, str]


def contestants(robosuite: str | None, gym_aloha: str | None) -> list[Contestant]:
    """Return what is measured, with the peers whose interpreters are given."""
    found = [
        Contestant(f"yamsim {task}, {quality}", "yamsim_task", sys.executable, "yamsim_cli", {**names})
        for task in ("pickplace", "cans_into_bin")
        for quality in ("balanced", "fast")
        for names in ({"task": task, "quality": quality},)
    ]
    if robosuite:
        found.append(Contestant("robosuite Lift", "robosuite_lift", robosuite, "robosuite", {}))
    if gym_aloha:
        found.append(Contestant("gym-aloha TransferCube", "gym_aloha_transfer", gym_aloha, "gym_aloha", {}))
    return found


def require_package(contestant: Contestant) -> None:
    """Exit with a message unless an interpreter exists and has its package."""
    try:
        answer = subprocess.run(
            [
                contestant.python,
                "-c",
                f"import importlib.util, sys; sys.exit(not importlib.util.find_spec({contestant.package!r}))",
            ],
            capture_output=True,
            check=False,
        )
    except OSError as error:
        raise SystemExit(f"{contestant.python}: {error.strerror}; give the interpreter of an environment") from None
    if answer.returncode:
        raise SystemExit(
            f"{contestant.python} has no {contestant.package}; install {contestant.package.replace('_', '-')} "
            "in a virtual environment of its own, and give the environment's interpreter"
        )


def run(contestant: Contestant, work: Work, frames: int) -> dict[str, Any] | None:
    """Return the line of a program; None if the task has too few cameras. Exits if the program fails."""
    asked = {
        "frames": frames,
        "cameras": work.cameras,
        "width": work.width,
        "height": work.height,
        "hz": _FRAMES_PER_SECOND,
        **contestant.settings,
    }
    if contestant.settings.get("task") == "pickplace" and work.cameras > 2:
        return None
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(_ROOT) if contestant.settings else ""}
    done = subprocess.run(
        [contestant.python, str(_PROGRAMS / f"{contestant.program}.py"), json.dumps(asked)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=_TIME_LIMIT,
        check=False,
    )
    if done.returncode:
        reason = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise SystemExit(f"{contestant.name} failed: {reason}")
    found: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robosuite", metavar="PYTHON")
    parser.add_argument("--gym-aloha", metavar="PYTHON")
    parser.add_argument("--images", nargs="+", choices=list(_WORKS), default=list(_WORKS), help="sets of cameras")
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    measured = contestants(arguments.robosuite, arguments.gym_aloha)
    for contestant in measured:
        require_package(contestant)
    rows: list[dict[str, Any]] = []
    table = Table(title=f"CPU time, median of {arguments.rounds} rounds; load {os.getloadavg()[0]:.1f}")
    for column in (
        "images",
        "simulator",
        "without images, ms/frame",
        "images, ms each",
        "frames/core-s",
        "episodes/core-s",
    ):
        table.add_column(column, justify="left" if column in ("images", "simulator") else "right")
    for work in (_WORKS[name] for name in arguments.images):
        results: dict[str, list[dict[str, Any]]] = {}
        for _ in range(arguments.rounds):
            for contestant in measured:
                if (found := run(contestant, work, arguments.frames)) is not None:
                    results.setdefault(contestant.name, []).append(found)
        for name, each in results.items():
            physics = statistics.median(one["physics_s"] for one in each) / arguments.frames
            image = statistics.median(one["pictures_s"] for one in each) / arguments.frames / work.cameras
            episode = _FRAMES_PER_EPISODE * (physics + image * work.cameras)
            table.add_row(
                str(work), name, f"{physics * 1e3:.1f}", f"{image * 1e3:.1f}", f"{1 / image:.1f}", f"{1 / episode:.3f}"
            )
            rows.append({"images": str(work), "simulator": name, "versions": each[0]["versions"], "runs": each})
    console = Console(width=120)
    console.print(table)
    for versions in dict.fromkeys(row["versions"] for row in rows):
        console.print(versions)
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
