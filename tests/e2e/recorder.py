"""Start `yamsim record` as a user does, inspect its processes, and make small filesystems."""

from __future__ import annotations

import functools
import hashlib
import os
import shlex
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.run_cli import yamsim

ROOT = Path(__file__).parents[2]
SMALL = ("--size", "64x48", "--quality", "fast", "--seed", "3")


def start(out: Path, *flags: str, env: dict[str, str] | None = None) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "yamsim_cli", "record", "--out", str(out), *SMALL, *flags],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT), **(env or {})},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def run(out: Path, *flags: str) -> tuple[int, str]:
    """Return exit code, and stderr without lines of progress."""
    done = yamsim("record", "--out", out, *SMALL, *flags, fresh="ray" in flags)
    return done.code, without_progress(done.err)


def without_progress(err: str) -> str:
    return "".join(line for line in err.splitlines(keepends=True) if not line.startswith("recording: "))


def workers_of(pid: int) -> list[int]:
    """Processes that the recorder `pid` has started."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        return [int(child) for child in children if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()]
    except FileNotFoundError:
        return []


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def wait_until(condition: Callable[[], object], seconds: float = 600) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"not within {seconds} s"
        time.sleep(0.01)


def episodes(dataset: Path) -> list[str]:
    return sorted(path.name for path in dataset.glob("ep_*"))


def digest(dataset: Path) -> dict[str, str]:
    """Hash of every file of a dataset."""
    return {
        path.relative_to(dataset).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(dataset.rglob("*"))
        if path.is_file()
    }


@functools.cache
def _may_mount() -> str | None:
    """Return why this kernel forbids mounting in a namespace; None if it allows it."""
    try:
        probe = ["unshare", "-rm", "sh", "-c", "mount -t tmpfs -o size=64k none /mnt"]
        done = subprocess.run(probe, capture_output=True, text=True, timeout=20, check=False)
    except FileNotFoundError:
        return "no `unshare` here"
    return None if done.returncode == 0 else done.stderr.strip() or "unshare failed"


def in_namespace(script: str, **values: object) -> subprocess.CompletedProcess[str]:
    """Run a shell script in a user and mount namespace; skip if that is forbidden.

    Args:
        script: `$record FLAGS` in it records; other `$names` are `values`.
    """
    if (why := _may_mount()) is not None:
        pytest.skip(f"mounting is not allowed here: {why}")
    lines = [f"{name}={shlex.quote(str(value))}" for name, value in values.items()]
    record = shlex.join([sys.executable, "-m", "yamsim_cli", "record", *SMALL])
    text = "\n".join(["set -u", *lines, f'record() {{ {record} --out "$out" "$@"; }}', script])
    return subprocess.run(
        ["unshare", "-rm", "sh", "-c", text],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
