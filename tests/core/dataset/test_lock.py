from __future__ import annotations

import errno
import fcntl
import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.core.dataset.making import CONFIG, tree
from yamsim_cli.core.dataset.writing.directory_claim import DirectoryLock, ExistingDatasetMode
from yamsim_cli.core.dataset.writing.writer import DatasetWriter
from yamsim_cli.core.errors import ResourceError, UsageError

HOST = socket.gethostname()


@contextmanager
def recorder(path: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that records into `path`."""
    code = (
        "from pathlib import Path\n"
        "from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode\n"
        "from yamsim_cli.core.dataset.writing.writer import DatasetWriter\n"
        f"writer = DatasetWriter(Path({str(path)!r}), {CONFIG!r}, ExistingDatasetMode.RESUME)\n"
        "print('recording', flush=True)\n"
        "input()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])},
    ) as process:
        assert process.stdout
        assert process.stdout.readline() == "recording\n"
        try:
            yield process
        finally:
            process.kill()


@pytest.mark.parametrize("mode", ExistingDatasetMode)
def test_a_second_recorder_is_refused_and_told_who_the_first_is(tmp_path: Path, mode: ExistingDatasetMode) -> None:
    path = tmp_path / "dataset"
    with recorder(path) as first:
        before = tree(path)
        with pytest.raises(
            ResourceError, match=f"is being recorded into by process {first.pid} on {HOST}; wait for it"
        ):
            DatasetWriter(path, CONFIG, mode)
        assert tree(path) == before
        assert list(tmp_path.iterdir()) == [path]


def test_a_killed_recorder_blocks_nobody(tmp_path: Path) -> None:
    with recorder(tmp_path) as first:
        first.kill()
        first.wait()
        assert (tmp_path / ".lock").exists()
        with DatasetWriter(tmp_path, CONFIG, ExistingDatasetMode.RESUME):
            assert json.loads((tmp_path / ".lock").read_text()) == {"pid": os.getpid(), "host": HOST}
    assert tree(tmp_path).keys() == {"config.yaml"}


def test_a_writer_that_is_refused_leaves_no_lock(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(UsageError):
        DatasetWriter(tmp_path, CONFIG, ExistingDatasetMode.NEW)
    assert tree(tmp_path).keys() == {"thesis.tex"}


def test_a_lock_that_its_holder_just_removed_is_not_mistaken_for_the_new_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between opening and locking the file, the holder ends and a third recorder begins."""
    first = DirectoryLock.acquire(tmp_path)
    third: list[DirectoryLock] = []
    real = fcntl.flock

    def slow(descriptor: int, operation: int) -> None:
        if not third:
            first.release()
            third.append(None)  # type: ignore[arg-type]
            third[0] = DirectoryLock.acquire(tmp_path)
        real(descriptor, operation)

    monkeypatch.setattr(fcntl, "flock", slow)
    with pytest.raises(ResourceError, match=str(os.getpid())):
        DirectoryLock.acquire(tmp_path)
    third[0].release()


def mark(directory: Path, pid: int, host: str) -> None:
    (directory / ".lock").write_text(json.dumps({"pid": pid, "host": host}))


def test_a_file_left_by_another_machine_counts_where_locks_do_not_reach_it(tmp_path: Path) -> None:
    mark(tmp_path, 12, "elsewhere")
    with pytest.raises(ResourceError, match=r"by process 12 on elsewhere, and .* if it has ended, delete .*/\.lock"):
        DirectoryLock.acquire(tmp_path, reaches_others=False)
    DirectoryLock.acquire(tmp_path, reaches_others=True).release()


@pytest.fixture
def no_flock(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(descriptor: int, operation: int) -> None:
        raise OSError(errno.EOPNOTSUPP, os.strerror(errno.EOPNOTSUPP))

    monkeypatch.setattr(fcntl, "flock", refuse)


@pytest.mark.usefixtures("no_flock")
@pytest.mark.parametrize("content", ["", "{", "[]", '{"pid": "x", "host": 1}'])
def test_without_locks_a_file_that_says_nothing_blocks_nobody(tmp_path: Path, content: str) -> None:
    (tmp_path / ".lock").write_text(content)
    DirectoryLock.acquire(tmp_path).release()


@pytest.mark.usefixtures("no_flock")
def test_without_locks_a_process_that_has_ended_blocks_nobody(tmp_path: Path) -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    mark(tmp_path, ended.pid, HOST)
    DirectoryLock.acquire(tmp_path).release()


@pytest.mark.usefixtures("no_flock")
@pytest.mark.parametrize("host", [HOST, "elsewhere"])
def test_without_locks_a_process_that_may_live_is_believed(tmp_path: Path, host: str) -> None:
    mark(tmp_path, os.getppid(), host)
    with pytest.raises(ResourceError, match=f"by process {os.getppid()} on {host}"):
        DirectoryLock.acquire(tmp_path)


def test_other_faults_of_the_disk_are_not_taken_for_a_missing_lock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(descriptor: int, operation: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(fcntl, "flock", fail)
    with pytest.raises(OSError, match="Input/output error"):
        DirectoryLock.acquire(tmp_path)
