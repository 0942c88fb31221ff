"""Cores and memory that this process may use in containers and batch systems."""

from __future__ import annotations

import os
from pathlib import Path, PurePosixPath

CGROUP_FOLDER = Path("/sys/fs/cgroup")
CGROUP_MEMBERSHIP_FILE = Path("/proc/self/cgroup")
MEMINFO_FILE = Path("/proc/meminfo")


def usable_cores() -> int:
    """Return the number of cores that this process may use, by CPU affinity and a container's quota."""
    granted = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quotas = []
    for group in _control_groups():
        # Source: Linux's cgroup-v2.rst, cpu.max: "$MAX $PERIOD", or "max" for no limit.
        quota, _, period = _read_if_present(group / "cpu.max").partition(" ")
        if quota.isdecimal() and period.strip().isdecimal():
            quotas.append(int(quota) / int(period))
    return max(1, int(min([granted, *quotas])))


def usable_memory() -> int | None:
    """Return the bytes that this process may still allocate; None if unknown."""
    left = []
    for line in _read_if_present(MEMINFO_FILE).splitlines():
        if line.startswith("MemAvailable:"):
            left.append(int(line.split()[1]) * 1024)
    for group in _control_groups():
        limit, used = _read_if_present(group / "memory.max").strip(), _read_if_present(group / "memory.current").strip()
        if limit.isdecimal() and used.isdecimal():
            left.append(max(0, int(limit) - int(used)))
    return min(left, default=None)


def _control_groups() -> list[Path]:
    """Return the control group of this process and its parents, whose limits apply too."""
    for line in _read_if_present(CGROUP_MEMBERSHIP_FILE).splitlines():
        # Source: Linux's cgroup-v2.rst: the unified hierarchy's line is "0::$PATH".
        if line.startswith("0::"):
            own = PurePosixPath(line[3:].strip().lstrip("/"))
            return [CGROUP_FOLDER / own, *(CGROUP_FOLDER / parent for parent in own.parents)]
    return []


def _read_if_present(file: Path) -> str:
    try:
        return file.read_text()
    except OSError:
        return ""
