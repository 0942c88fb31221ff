"""Stages of a bench that are not done again: programs with a log and their seconds in a folder."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import time
from collections.abc import Mapping, Sequence
from pathlib import Path


def run_stage(
    out: Path, name: str, program: Sequence[str], *, nice: int = 0, environ: Mapping[str, str] | None = None
) -> dict[str, float]:
    """Run a program unless its result exists in `out`, and return its wall and processor seconds.

    Args:
        out: folder of `<name>.log` and `<name>.seconds.json`.
        nice: niceness of the program.
        environ: further environment variables.

    Raises:
        SystemExit: the program fails; with the end of its log.
    """
    told, log = out / f"{name}.seconds.json", out / f"{name}.log"
    if not told.exists():
        before, began = _children(), time.monotonic()
        with log.open("w") as file:
            command = ["nice", "-n", str(nice), *map(str, program)]
            code = subprocess.run(command, stdout=file, stderr=file, env={**os.environ, **(environ or {})}).returncode
        if code:
            raise SystemExit(f"{log}: exit code {code}: {log.read_text().strip()[-500:]}")
        told.write_text(json.dumps({"wall_s": time.monotonic() - began, "cpu_s": _children() - before}))
    seconds: dict[str, float] = json.loads(told.read_text())
    return seconds


def _children() -> float:
    """CPU seconds of all finished child processes."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
