"""Output files: one rule for all commands, checked before the work begins.

What exists is refused unless `--overwrite` is given, and so is a place where nothing can be written.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from yamsim_cli.core.errors import ResourceError, UsageError
from yamsim_cli.core.files import nearest_directory

MIN_FREE_BYTES = 1 << 16  # free space under which no output is begun: every report and picture of yamsim is larger

Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace files that exist.")]


def require_free(flag: str, files: Path | Iterable[Path], *, overwrite: bool) -> None:
    """Refuse files that exist, or that cannot be written, before the work that makes them.

    Args:
        flag: the option that names the files, for the message.
        files: one file, whose folder has to exist, or several in folders that are made later.
        overwrite: whether files that exist may be replaced.

    Raises:
        UsageError: a file exists and may not be replaced, is a directory, or has no folder.
        ResourceError: its file system is read-only or full.
    """
    one = isinstance(files, Path)
    for file in [files] if isinstance(files, Path) else files:
        folder = file.absolute().parent
        if file.is_dir():
            raise UsageError(f"{flag} {file} is a directory; give a file, such as {file / 'report'}")
        if file.exists() and not overwrite:
            raise UsageError(f"{flag} {file} exists; replace it with --overwrite, or give another path")
        if one and not folder.is_dir():
            raise UsageError(f"{flag} {file}: there is no directory {folder}; make it first")
        _require_writable(flag, nearest_directory(folder))


def _require_writable(flag: str, folder: Path) -> None:
    """Refuse a folder in which no file can be made, as far as this can be told without making one."""
    if not os.access(folder, os.W_OK | os.X_OK):
        raise ResourceError(f"{flag}: {folder} cannot be written to; choose another path")
    free = shutil.disk_usage(folder).free
    if free < MIN_FREE_BYTES:
        raise ResourceError(f"{flag}: {folder} has {free} bytes left; free some space, or choose another path")
