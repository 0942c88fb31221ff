"""Things that are named by their file, where a config's name belongs: `--object my_mug.glb`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from ..thing_files.endings import ENDINGS

if TYPE_CHECKING:
    from ..resources import Locations


def config_of(name: str, where: Locations, notify: Callable[[str], None]) -> str:
    """The config of the thing that a name stands for: of a file it is made, and any other name is one already.

    Args:
        notify: told what was guessed.

    Raises:
        UsageError, ResourceError: as `from_file.import_directly`.
    """
    if Path(name).suffix.lower() not in ENDINGS:
        return name
    from .from_file import import_directly

    imported = import_directly(Path(name), where)
    if imported.made.guessed:
        notify(
            f"{name}: {imported.made.mass * 1000:.3g} g is a guess: `yamsim assets import {name} --mass KG` says more."
        )
    return str(imported.path)
