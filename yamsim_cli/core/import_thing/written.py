"""Where a made config is written."""

from __future__ import annotations

import re
from pathlib import Path

from ..errors import ResourceError, UsageError
from ..files import write_file
from ..resources import Locations


def own_config(where: Locations, name: str) -> Path:
    """The place of a config of the user's own.

    Raises:
        UsageError: there is none.
    """
    if len(where.data) < 2:
        raise UsageError("no folder for configs of your own: set YAMSIM_DATA_DIR, or give --out FILE.yaml")
    return where.data[0] / "configs" / "objects" / f"{name}.yaml"


def checked_name(name: str) -> str:
    """The name itself, if a thing can be called so.

    Raises:
        UsageError: it cannot.
    """
    if not re.fullmatch("[A-Za-z][A-Za-z0-9_]*", name):
        raise UsageError(f"--name {name!r} is not valid: letters, digits and underscores, a letter first")
    return name


def refuse_existing(path: Path) -> None:
    """Raise `UsageError` where a file is in the way, before work is done for it."""
    if path.exists():
        raise UsageError(f"{path} exists; move it away, or choose another --out")


def put(path: Path, data: bytes) -> None:
    """Write a file, its folder too. Raises `ResourceError`."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, data)
    except OSError as error:
        raise ResourceError(f"{path} cannot be written: {error.strerror}") from error
