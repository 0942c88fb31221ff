"""Import object files given in place of a config name, such as `--object my_mug.glb`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from ..readers import OBJECT_SUFFIXES

if TYPE_CHECKING:
    from yamsim_cli.core.files.resources import Locations


def import_if_file(name: str, locations: Locations, notify: Callable[[str], None]) -> str:
    """Return the config path of an imported object file, or any other name unchanged.

    Args:
        notify: called with a note about a guessed mass.

    Raises:
        UsageError: the file's unit or up axis is unknown, or its size is implausible.
        ResourceError: the file is refused or does not allow a valid config, or a file cannot be written.
    """
    if Path(name).suffix.lower() not in OBJECT_SUFFIXES:
        return name
    from .file_import import import_with_defaults

    imported = import_with_defaults(Path(name), locations)
    if imported.built_object.mass_is_guessed:
        notify(
            f"{name}: its mass of {imported.built_object.mass * 1000:.3g} g is a guess; "
            f"to give the mass, run `yamsim assets import {name} --mass KG`."
        )
    return str(imported.path)
