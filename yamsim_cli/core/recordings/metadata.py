"""What raiden's `metadata.json` beside a recording says of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

METADATA = "metadata.json"


# What raiden's recorder says of a recording that it did not end itself. Source: TRI-ML/raiden 2353b10, `recorder.py`.
_COMPLETE = "complete"


def prompt_of(directory: Path) -> str:
    """The task in words; empty where nobody said."""
    said = _said(directory)
    places = ((said.get("language"), ("prompt", "task")), (said, ("task_instruction", "instruction", "task_name")))
    for place, keys in places:
        for key in keys:
            if isinstance(place, dict) and isinstance(place.get(key), str):
                return str(place[key])
    return ""


def problems_of(directory: Path, frames: int | None = None) -> tuple[str, ...]:
    """What it says is wrong with the recording, for a person.

    Args:
        frames: how many were found; None where it says nothing of them.
    """
    said, file = _said(directory), directory / METADATA
    problems = []
    if said.get(_COMPLETE) is False:
        problems.append(f"{file} says that it is not complete: was the recording cut off?")
    if frames is not None and isinstance(count := said.get("num_frames"), int) and count > frames:
        problems.append(f"there are {frames} frames, and {file} says {count}: was it cut off?")
    return tuple(problems)


def _said(directory: Path) -> dict[str, Any]:
    try:
        said = json.loads((directory / METADATA).read_bytes())
    except (OSError, ValueError):
        return {}
    return said if isinstance(said, dict) else {}
