"""What raiden's `metadata.json` beside a recording says of it."""

from __future__ import annotations

import json
from pathlib import Path

METADATA = "metadata.json"


def prompt_of(directory: Path) -> str:
    """The task in words; empty where nobody said."""
    try:
        said = json.loads((directory / METADATA).read_bytes())
    except (OSError, ValueError):
        return ""
    language = said.get("language") if isinstance(said, dict) else None
    places = ((language, ("prompt", "task")), (said, ("task_instruction", "instruction", "task_name")))
    for place, keys in places:
        for key in keys:
            if isinstance(place, dict) and isinstance(place.get(key), str):
                return str(place[key])
    return ""
