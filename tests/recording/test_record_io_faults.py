"""Each call that changes the disk fails once, or is the last one: --resume repairs the dataset, nothing is lost."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import Any

import pytest

from tests.core.dataset.making import tree
from tests.recording.fake_episodes import Recording
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.dataset.dataset_paths import CONFIG_FILE
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.dataset.writing.integrity import inspect_episodes
from yamsim_cli.core.dataset.writing.ledger import Ledger
from yamsim_cli.core.errors import PartialJobError, ResourceError

CALLS = ("open", "write", "pwrite", "fsync", "ftruncate", "rename", "replace", "mkdir", "unlink", "rmdir")


class Fault(Enum):
    ONCE = "one call fails, the next ones work again: a server that stumbled"
    FOR_GOOD = "this call and all after it fail, those that clean up too: a full or dead disk, or a crash"
    TORN = "the same, and what was being written is half there"


class FailingDisk:
    """Wraps the calls that change the disk, and fails the n-th."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, nth: int = 0, fault: Fault = Fault.ONCE) -> None:
        self.calls = 0
        self._nth = nth
        self._fault = fault
        for name in CALLS:
            monkeypatch.setattr(os, name, self._wrapped(name, getattr(os, name)))

    def _wrapped(self, name: str, real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            if name == "open" and not arguments[1] & (os.O_CREAT | os.O_DIRECTORY):
                return real(*arguments, **options)
            self.calls += 1
            if self.calls == self._nth or (self._nth and self.calls > self._nth and self._fault is not Fault.ONCE):
                if self.calls == self._nth and self._fault is Fault.TORN and name == "write":
                    real(arguments[0], arguments[1][: len(arguments[1]) // 2])
                number = errno.ENOSPC if name in ("write", "mkdir") else errno.EIO
                raise OSError(number, os.strerror(number), "injected")
            return real(*arguments, **options)

        return call


def run(config: RecordConfig, path: Path, mode: ExistingDatasetMode, *, staged: bool = False) -> None:
    Recording(config, path, path.with_name(f"{path.name}-stage") if staged else None).run(mode=mode)


@pytest.fixture(autouse=True)
def _no_waiting_for_the_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Flushing matters only after a power failure; here it only counts, and fails."""
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)


@pytest.fixture
def config(make_config: Callable[..., RecordConfig]) -> RecordConfig:
    return make_config({("episodes",): 2, ("seed",): 1})


def assert_whole(path: Path) -> None:
    """Assert that everything is readable, and nothing incomplete has a final name."""
    if not path.is_dir():
        return
    assert all(found.fault is None for found in inspect_episodes(path))
    episodes = {found.number for found in inspect_episodes(path)}
    logged = {attempt.episode for attempt in Ledger(path).known_attempts.values()} - {None}
    assert logged <= episodes
    assert len(episodes - logged) <= 1, "the one that was published when the ledger failed"
    if episodes:
        assert (path / CONFIG_FILE).is_file()


def every_third(calls: int, fault: Fault) -> range:
    """Numbers of the calls that fail by a fault: together, the three faults meet every call."""
    return range(1 + list(Fault).index(fault), calls + 1, len(Fault))


@pytest.mark.slow
@pytest.mark.parametrize("staged", [False, True])
@pytest.mark.parametrize("fault", Fault)
def test_whichever_call_fails_nothing_is_lost(
    config: RecordConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: Fault, staged: bool
) -> None:
    """With a stage two threads write, so the n-th call varies."""
    with monkeypatch.context() as patch:
        disk = FailingDisk(patch)
        run(config, tmp_path / "undisturbed", ExistingDatasetMode.NEW, staged=staged)
    wanted = tree(tmp_path / "undisturbed")
    assert disk.calls > 40

    for nth in every_third(disk.calls, fault):
        path = tmp_path / f"{nth}"
        with monkeypatch.context() as patch:
            FailingDisk(patch, nth, fault)
            try:
                run(config, path, ExistingDatasetMode.NEW, staged=staged)
                survived = True
            except (PartialJobError, ResourceError) as error:
                survived = False
                assert "injected" in str(error) or "cannot be" in str(error), nth
        assert_whole(path)
        if survived:
            # Only clean-up may fail silently.
            assert wanted.items() <= tree(path).items(), nth
        run(config, path, ExistingDatasetMode.RESUME, staged=staged)
        assert tree(path) == wanted, nth
        assert not staged or list(path.with_name(f"{path.name}-stage").iterdir()) == [], nth
    print(f"{disk.calls} faults injected and survived, 0 episodes lost")


@pytest.mark.parametrize("fault", Fault)
@pytest.mark.slow
def test_whichever_call_fails_in_resuming_nothing_is_lost(
    config: RecordConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: Fault
) -> None:
    """From the state with the most to repair: a damaged episode, a lost one, a truncated ledger, no manifest."""

    def damaged(path: Path) -> None:
        run(config, path, ExistingDatasetMode.NEW)
        (path / "ep_000000/lowdim/000000.pkl").write_bytes(b"")
        (path / "ep_000001/episode.json").unlink()
        (path / "manifest.json").unlink()
        ledger = path / "attempts.jsonl"
        ledger.write_bytes(ledger.read_bytes()[:-10])

    run(config, tmp_path / "undisturbed", ExistingDatasetMode.NEW)
    wanted = tree(tmp_path / "undisturbed")
    damaged(tmp_path / "count")
    with monkeypatch.context() as patch:
        disk = FailingDisk(patch)
        run(config, tmp_path / "count", ExistingDatasetMode.RESUME)

    for nth in every_third(disk.calls, fault):
        path = tmp_path / f"{nth}"
        damaged(path)
        with monkeypatch.context() as patch:
            FailingDisk(patch, nth, fault)
            with contextlib.suppress(PartialJobError, ResourceError):
                run(config, path, ExistingDatasetMode.RESUME)
        run(config, path, ExistingDatasetMode.RESUME)
        mended = {name: data for name, data in tree(path).items() if not name.startswith(".damaged/")}
        assert mended == wanted, nth
        aside = [p for p in (path / ".damaged").iterdir() if p.is_dir()]
        assert len(aside) == 2, "both damaged episodes are still there"
    print(f"{disk.calls} faults injected and survived, 0 episodes lost")
