"""Starts MuJoCo's Filament, and finds out before whether it can."""

from __future__ import annotations

import ctypes
import functools
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from ..core.errors import ResourceError
from ..core.extras import require_library

EXTRA = "photo"
INSTALL_VULKAN = "on Debian or Ubuntu: apt-get install libvulkan1 mesa-vulkan-drivers"
MAX_BYTES = 1_500_000_000  # memory of a process with Filament, about 40 images, after which another one replaces it
_PROBE_SECONDS = 60  # s, after which a Vulkan driver counts as hung
# Filament aborts its process if no Vulkan driver works, so the first context is made in a separate process.
_PROBE_PROGRAM = """
import mujoco.studio
from mujoco import mjrf
mjrf.Context(mjrf.ContextConfig(graphics_api=mjrf.GraphicsApi.GRAPHICS_API_VULKAN, software_rendering=False))
"""
_DEVICE_LINE = "Selected physical device '"  # how Filament reports the device


@functools.cache
def require_filament() -> str:
    """Return the name of the Vulkan device.

    Raises:
        ResourceError: `mujoco-studio` is not installed, or no Vulkan driver works.
    """
    require_library("--quality photo", "mujoco.studio", EXTRA)
    try:
        done = subprocess.run(
            [sys.executable, "-c", _PROBE_PROGRAM], capture_output=True, text=True, errors="replace",
            timeout=_PROBE_SECONDS, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise ResourceError(
            f"--quality photo needs a Vulkan driver, and the one here hangs: no answer after {_PROBE_SECONDS} s; "
            f"{INSTALL_VULKAN}"
        ) from None
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        raise ResourceError(
            f"--quality photo needs a Vulkan driver, and none works here ({lines[-1].strip()}); {INSTALL_VULKAN}"
        )
    return done.stdout.partition(_DEVICE_LINE)[2].partition("'")[0] or "Vulkan"


@functools.cache
def open_context() -> Any:
    """Return the process's context of Filament."""
    import mujoco.studio  # noqa: F401 - registers Filament's materials
    from mujoco import mjrf

    with _silent_stdout():
        return mjrf.Context(
            mjrf.ContextConfig(graphics_api=mjrf.GraphicsApi.GRAPHICS_API_VULKAN, software_rendering=False)
        )


@contextmanager
def _silent_stdout() -> Iterator[None]:
    """Discard what libraries print: Filament reports its start on the standard output."""
    libc = ctypes.CDLL(None)
    sys.stdout.flush()
    libc.fflush(None)
    kept = os.dup(1)
    try:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.close(nowhere)
        yield
    finally:
        libc.fflush(None)
        os.dup2(kept, 1)
        os.close(kept)
