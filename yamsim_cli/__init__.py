"""yamsim: simulation toolkit for the I2RT YAM arm."""

from __future__ import annotations

import importlib
import sys
from typing import Any

__version__ = "0.1.0"

# From Python, see `yamsim_cli.api`; loaded when first asked for, so that the command line starts quickly.
__all__ = ["evaluate", "open_dataset", "record"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        return getattr(importlib.import_module(f"{__name__}.api"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


if "gymnasium" in sys.modules:
    # Whoever has gymnasium finds the environment registered.
    importlib.import_module(f"{__name__}.gym_env")
