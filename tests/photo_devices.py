"""Vulkan devices for tests of quality `photo`."""

from __future__ import annotations

import functools

from yamsim_cli.core.errors import ResourceError
from yamsim_cli.photo_rendering.filament_context import require_filament


@functools.cache
def missing_filament() -> str:
    """Return why quality `photo` cannot be tested here; empty if it can."""
    try:
        require_filament()
    except ResourceError as error:
        return str(error)
    return ""
