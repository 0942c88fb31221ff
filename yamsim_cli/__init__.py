"""yamsim: simulation toolkit for the I2RT YAM arm."""

from __future__ import annotations

import importlib
import sys
from typing import Any

__version__ = "0.2.0"

# Public name -> module, loaded at the first use of one of its names, so that the command line starts fast.
_PUBLIC = {
    **dict.fromkeys(("evaluate", "open_dataset", "record"), "api"),
    **dict.fromkeys(("Kinematics", "OutOfReachError"), "kinematics"),
    "RecordReport": "recording.recorder",
    "ChunkWindows": "training.chunk_windows",
    "ShuffledBatches": "training.shuffled_batches",
    **dict.fromkeys(("StoredEpisode", "StoredEpisodes"), "core.dataset.reader"),
    **dict.fromkeys(("EpisodeRecord", "OutcomeRecord"), "core.dataset.records"),
    **dict.fromkeys(
        (
            "ConfigError",
            "DatasetError",
            "InterruptedJobError",
            "PartialJobError",
            "ResourceError",
            "SimulationError",
            "UsageError",
            "YamsimError",
        ),
        "core.errors",
    ),
}

__all__ = sorted(_PUBLIC)


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(importlib.import_module(f"{__name__}.{_PUBLIC[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


if "gymnasium" in sys.modules:
    # Register the environment for programs that have already imported gymnasium.
    importlib.import_module(f"{__name__}.gym_env")
