"""CPU time of an attempt of the expert without images, and the part of MuJoCo's steps in it.

    python -m tools.bench.trial [--against CHECKOUT] [--task pickplace] [--attempts 10] [--rounds 5]

`--against` measures another checkout in alternation, with the same Python, and compares the recorded states.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

_HERE = Path(__file__).resolve().parents[2]

# Arguments: task and number of attempts. Prints the CPU seconds of each attempt, those of its physics steps, the number
# of steps, and the hash of all recorded states and outcomes.
_PROGRAM = """
import hashlib, json, os, sys, time
import mujoco
from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.episode.execution import simulate_expert
from yamsim_cli.core.episode.sampling import sample_attempt
from yamsim_cli.core.episode.simulator import SimulatorCache
from yamsim_cli.session_opener import SessionOpener
task, attempts = sys.argv[1], int(sys.argv[2])
opener = SessionOpener(os.environ, lambda text: None, lambda name: name)
session = opener.open("default", renders=False, task=task).without_meshes()
step, spent, hashed, totals, physics = mujoco.mj_step, [], hashlib.sha256(), [], []
def timed_step(model, data, nstep=1):
    began = time.process_time()
    step(model, data, nstep)
    spent.append(time.process_time() - began)
with SimulatorCache(session) as cache:
    def attempt(number):
        job = AttemptJob(101, number)
        simulator = cache.get(job)
        return simulate_expert(simulator, sample_attempt(simulator, job))
    attempt(0)
    for number in range(attempts):
        began = time.process_time()
        done = attempt(number)
        totals.append(time.process_time() - began)
        for state in done.recorded_states:
            hashed.update(state.qpos.tobytes() + state.actions.ctrl.tobytes())
        hashed.update(repr(done.outcome).encode())
    mujoco.mj_step = timed_step
    steps = 0
    for number in range(attempts):
        spent.clear()
        attempt(number)
        physics.append(sum(spent))
        steps += len(spent)
print(json.dumps({"totals": totals, "physics": physics, "steps": steps, "hash": hashed.hexdigest()}))
"""


def measure(checkout: Path, task: str, attempts: int) -> dict[str, Any]:
    """Return what `_PROGRAM` prints in a checkout."""
    printed = subprocess.check_output(
        [sys.executable, "-c", _PROGRAM, task, str(attempts)],
        env=os.environ | {"PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1"},
        text=True,
    )
    found: dict[str, Any] = json.loads(printed)
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--against", type=Path, help="root of another checkout")
    parser.add_argument("--task", default="pickplace")
    parser.add_argument("--attempts", type=int, default=10)
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    checkouts = {"this checkout": _HERE}
    if arguments.against is not None:
        checkouts = {"the other": arguments.against.resolve(), **checkouts}
    runs: dict[str, list[dict[str, Any]]] = {name: [] for name in checkouts}
    for _ in range(arguments.rounds):
        for name, checkout in checkouts.items():
            runs[name].append(measure(checkout, arguments.task, arguments.attempts))
    # Other load only adds time, so the lowest of an attempt's rounds is nearest to the truth.
    table = Table(title=f"{arguments.task}: CPU ms an attempt, lowest of rounds; load {os.getloadavg()[0]:.1f}")
    for column in ("checkout", "attempt", "MuJoCo's steps", "us a step", "steps", "states"):
        table.add_column(column)
    for name, each in runs.items():
        total, physics = (
            statistics.mean(min(rounds) for rounds in zip(*(run[key] for run in each), strict=True)) * 1e3
            for key in ("totals", "physics")
        )
        steps = each[0]["steps"] / arguments.attempts
        table.add_row(
            name, f"{total:.0f}", f"{physics:.0f}", f"{physics / steps * 1e3:.1f}", f"{steps:.0f}", each[0]["hash"][:12]
        )
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
