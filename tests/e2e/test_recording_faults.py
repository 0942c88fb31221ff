"""Real faults: killed processes, full and read-only disks, two recorders at once, a clock that jumps."""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cli.run_cli import yamsim
from tests.e2e.recorder import (
    ROOT,
    SMALL,
    digest,
    episodes,
    in_namespace,
    is_alive,
    run,
    start,
    wait_until,
    without_progress,
    workers_of,
)

pytestmark = [pytest.mark.render, pytest.mark.slow]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    path = tmp_path_factory.mktemp("faults") / "undisturbed"
    code, err = run(path, "--n", "4", "--workers", "2")
    assert code == 0, err
    return digest(path)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV])
def test_a_killed_worker_is_replaced(undisturbed: dict[str, str], tmp_path: Path, number: signal.Signals) -> None:
    path = tmp_path / "d"
    with start(path, "--n", "4", "--workers", "2") as process:
        wait_until(lambda: episodes(path))
        before = workers_of(process.pid)
        os.kill(before[0], number)
        wait_until(lambda: set(workers_of(process.pid)) - set(before))
        err = without_progress(process.communicate(timeout=120)[1])
    assert (process.returncode, err) == (0, "")
    assert digest(path) == undisturbed


def test_a_frozen_worker_is_replaced(undisturbed: dict[str, str], tmp_path: Path) -> None:
    path = tmp_path / "d"
    with start(path, "--n", "4", "--workers", "2", "--attempt-timeout", "20") as process:
        wait_until(lambda: episodes(path))
        before = workers_of(process.pid)
        os.kill(before[0], signal.SIGSTOP)
        err = without_progress(process.communicate(timeout=180)[1])
    assert (process.returncode, err) == (0, "")
    assert digest(path) == undisturbed
    assert not is_alive(before[0])


def test_workers_end_with_a_killed_recorder(undisturbed: dict[str, str], tmp_path: Path) -> None:
    path = tmp_path / "d"
    with start(path, "--n", "4", "--workers", "2") as process:
        wait_until(lambda: episodes(path))
        workers = workers_of(process.pid)
        assert len(workers) == 2
        process.kill()
        wait_until(lambda: not any(map(is_alive, workers)), seconds=2)
    assert run(path, "--n", "4", "--resume") == (0, "")
    assert digest(path) == undisturbed


def test_a_second_recorder_is_refused(undisturbed: dict[str, str], tmp_path: Path) -> None:
    path = tmp_path / "d"
    with start(path, "--n", "4", "--workers", "1") as first:
        wait_until(lambda: (path / ".lock").exists() and (path / "config.yaml").exists())
        # Still recording, however long the others take.
        first.send_signal(signal.SIGSTOP)
        for flag in ("--resume", "--overwrite", "--no-wrist"):
            code, err = run(path, "--n", "4", flag)
            assert code == 4
            assert f"process {first.pid} on {socket.gethostname()}" in err
        first.send_signal(signal.SIGCONT)
        err = without_progress(first.communicate(timeout=120)[1])
    assert (first.returncode, err) == (0, "")
    assert digest(path) == undisturbed


# Records in the background; `spoil` acts once an episode exists, and is undone before the rest is recorded.
SPOILED = """
mkdir -p "$disk"
mount -t tmpfs -o "$options" none "$disk"
out=$disk/d
record --n 4 --workers 1 2> "$log" &
while ! [ -e "$out/ep_000000" ]; do sleep 0.02; done
eval "$spoil" 2> /dev/null
wait $!
echo "exit $?"
cp -r "$out" "$copy"
eval "$mend"
record --n 4 --workers 2 --resume 2>> "$log"
echo "exit $?"
cp -r "$out" "$result"
"""
# A read-only view of the directory: open files stay open, as on a failing disk.
READ_ONLY = 'mount --bind "$out" "$out" && mount -o remount,bind,ro "$out"'


@pytest.mark.parametrize(
    ("options", "spoil", "mend", "message"),
    [
        (
            "size=8m,nr_inodes=2000",
            'dd if=/dev/zero of="$disk/filler"',
            'rm "$disk/filler"',
            "no space left on the device",
        ),
        (
            "size=20m,nr_inodes=1400",
            'mkdir "$disk/filler"; cd "$disk/filler"; touch $(seq 2000); cd "$OLDPWD"',
            'rm -r "$disk/filler"',
            "no inodes left on the device",
        ),
        ("size=20m", READ_ONLY, 'umount "$out"', "Read-only file system"),
    ],
    ids=["full", "out of inodes", "read-only"],
)
def test_a_disk_that_turns_bad_loses_nothing(
    undisturbed: dict[str, str], tmp_path: Path, options: str, spoil: str, mend: str, message: str
) -> None:
    files = {name: tmp_path / name for name in ("disk", "log", "copy", "result")}
    done = in_namespace(SPOILED, options=options, spoil=spoil, mend=mend, **files)
    log = without_progress(files["log"].read_text())
    assert [line for line in done.stdout.splitlines() if line.startswith("exit")] == ["exit 6", "exit 0"], log
    assert message in log
    assert "of 4 episodes" in log and "--resume" in log
    assert len(log.splitlines()) == 1, log
    assert episodes(files["copy"])
    # The disk may fail between an episode and its ledger line, which `--resume` then writes.
    problems = yamsim("summarize", files["copy"], "--json").json["problems"]
    assert {problem["file"] for problem in problems} <= {"manifest.json", "attempts.jsonl"}
    assert all("--resume" in problem["advice"] for problem in problems)
    assert digest(files["result"]) == undisturbed


def test_a_disk_that_is_read_only_from_the_start_is_refused(tmp_path: Path) -> None:
    script = """
        mkdir -p "$out"
        mount --bind "$out" "$out"
        mount -o remount,bind,ro "$out"
        record --n 1
    """
    done = in_namespace(script, out=tmp_path / "d")
    assert done.returncode == 4
    assert done.stderr.startswith(f"yamsim: {tmp_path / 'd'} cannot be written: Read-only file system")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    ("options", "what"), [("size=2m", "room for 1 MB in"), ("size=40m,nr_inodes=80", "files: 0 fit")]
)
def test_a_disk_that_is_too_small_is_refused_before_anything_is_made(tmp_path: Path, options: str, what: str) -> None:
    script = 'mount -t tmpfs -o "$options" none "$disk"; record --n 4; code=$?; ls -A "$disk"; exit $code'
    done = in_namespace(script, options=options, disk=tmp_path, out=tmp_path / "d")
    assert (done.returncode, done.stdout) == (4, "")
    assert re.match(r"yamsim: 4 episodes take at least 3\d\d files and 2 MB, but ", done.stderr)
    assert what in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_a_limit_on_file_sizes_loses_nothing(tmp_path: Path) -> None:
    path = tmp_path / "limited"
    script = (
        "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (12000, 12000))\n"
        "import signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        f"import sys; sys.argv = ['yamsim', 'record', '--n', '1', '--out', {str(path)!r}, *{SMALL!r}]\n"
        "from yamsim_cli.main import main; main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 6, done.stderr
    assert (
        "File too large: a limit on file sizes is in force: see ulimit -f: 0 of 1 episodes are complete" in done.stderr
    )
    assert episodes(path) == []
    assert not (path / ".staging").exists()


def faketime_library() -> Path | None:
    return next(Path("/usr/lib").glob("*/faketime/libfaketimeMT.so.1"), None)


def test_a_clock_that_is_set_back_changes_nothing(undisturbed: dict[str, str], tmp_path: Path) -> None:
    library = faketime_library()
    if library is None:
        pytest.skip("libfaketime is not installed")
    path, clock = tmp_path / "d", tmp_path / "clock"
    clock.write_text("+0")
    # libfaketime refuses Python's sleep call (clock_nanosleep, EINVAL), so another one is used.
    (tmp_path / "sitecustomize.py").write_text(
        "import select, time\ntime.sleep = lambda seconds: select.select([], [], [], seconds)\n"
    )
    environment = {
        "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}",
        "LD_PRELOAD": str(library),
        "FAKETIME_TIMESTAMP_FILE": str(clock),
        "FAKETIME_NO_CACHE": "1",
        "FAKETIME_DONT_FAKE_MONOTONIC": "1",
    }
    with start(path, "--n", "4", "--workers", "2", env=environment) as process:
        wait_until(lambda: episodes(path))
        clock.write_text("-400d")
        err = without_progress(process.communicate(timeout=180)[1])
    assert (process.returncode, err) == (0, "")
    assert digest(path) == undisturbed


@pytest.fixture
def fuse(tmp_path: Path) -> Iterator[Path]:
    """A directory on a FUSE mount."""
    if shutil.which("bindfs") is None:
        pytest.skip("bindfs is not installed")
    source, point = tmp_path / "behind", tmp_path / "remote"
    source.mkdir()
    point.mkdir()
    with subprocess.Popen(["bindfs", "-f", str(source), str(point)], stderr=subprocess.PIPE, text=True) as server:
        try:
            while not os.path.ismount(point):
                if server.poll() is not None:
                    assert server.stderr
                    pytest.skip(f"FUSE is not allowed here: {server.stderr.read().strip()}")
            yield point
        finally:
            subprocess.run(["umount", "-l", str(point)], check=False, capture_output=True)
            server.kill()


def test_a_network_mount_is_mentioned_and_a_stage_bears_kills(
    undisturbed: dict[str, str], tmp_path: Path, fuse: Path
) -> None:
    path, stage = fuse / "d", tmp_path / "stage"
    with start(path, "--n", "4", "--workers", "2", "--stage", str(stage)) as process:
        wait_until(lambda: episodes(path) or list(stage.glob("*/ep_*")))
        process.kill()
    code, err = run(path, "--n", "4", "--workers", "2", "--stage", str(stage), "--resume")
    assert code == 0, err
    assert digest(path) == undisturbed
    assert list(stage.iterdir()) == []

    code, err = run(path, "--n", "4", "--resume")
    assert code == 0
    assert f"{path} is on {fuse}, which is fuse" in err
    assert "With --stage DIR" in err
