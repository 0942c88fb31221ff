from __future__ import annotations

import os
from pathlib import Path

import pytest

from yamsim_cli import cpu_limits as machine
from yamsim_cli.cpu_limits import usable_cores, usable_memory


@pytest.fixture
def container(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A control group `/job/step` of a machine with eight cores and 32 GB."""
    (tmp_path / "groups/job/step").mkdir(parents=True)
    (tmp_path / "membership").write_text("0::/job/step\n")
    (tmp_path / "meminfo").write_text("MemTotal: 32000000 kB\nMemAvailable:   20000000 kB\n")
    monkeypatch.setattr(machine, "CGROUP_FOLDER", tmp_path / "groups")
    monkeypatch.setattr(machine, "CGROUP_MEMBERSHIP_FILE", tmp_path / "membership")
    monkeypatch.setattr(machine, "MEMINFO_FILE", tmp_path / "meminfo")
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(8)), raising=False)
    return tmp_path / "groups"


def test_without_limits_all_is_there(container: Path) -> None:
    (container / "job/step/cpu.max").write_text("max 100000\n")
    (container / "job/step/memory.max").write_text("max\n")
    assert usable_cores() == 8
    assert usable_memory() == 20_480_000_000


@pytest.mark.parametrize("group", ["job/step", "job"])
def test_limits_hold_wherever_they_are_set(container: Path, group: str) -> None:
    (container / group / "cpu.max").write_text("250000 100000\n")
    (container / group / "memory.max").write_text("3000000000\n")
    (container / group / "memory.current").write_text("1000000000\n")
    assert usable_cores() == 2
    assert usable_memory() == 2_000_000_000


def test_part_of_a_core_is_one(container: Path) -> None:
    (container / "job/step/cpu.max").write_text("50000 100000\n")
    assert usable_cores() == 1


def test_a_machine_without_cgroup_files_has_its_own_cores(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "CGROUP_MEMBERSHIP_FILE", tmp_path / "none")
    monkeypatch.setattr(machine, "MEMINFO_FILE", tmp_path / "none")
    assert usable_cores() >= 1
    assert usable_memory() is None
