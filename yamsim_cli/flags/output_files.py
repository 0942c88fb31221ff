"""Check output files before a command starts.

An existing file is an error without `--overwrite`; a folder without write access always is.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from yamsim_cli.core.errors import ResourceError, UsageError
from yamsim_cli.core.files.writing import nearest_directory, write_output
from yamsim_cli.terminal.console import print_note

if TYPE_CHECKING:
    from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode

MIN_FREE_BYTES = 1 << 16  # no command starts with less; reports and pictures are larger

Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace files that exist.")]
ContinueDataset = Annotated[bool, typer.Option("--resume", help="Continue a dataset that was interrupted.")]
RenameExisting = Annotated[bool, typer.Option("--overwrite", help="Rename an existing output.")]
VideoTrials = Annotated[int, typer.Option(min=1, metavar="N", help="With --video: largest number of trials.")]
ReportFile = Annotated[Path | None, typer.Option(help="Also write the JSON report to this file.")]


def open_mode(*, resume: bool, overwrite: bool) -> ExistingDatasetMode:
    """Return whether to create, resume or replace the output dataset."""
    from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode

    if resume and overwrite:
        raise UsageError("--resume and --overwrite exclude each other; give one of them")
    return (
        ExistingDatasetMode.RESUME
        if resume
        else ExistingDatasetMode.OVERWRITE
        if overwrite
        else ExistingDatasetMode.NEW
    )


def require_unused_paths(flag: str, files: Path | Iterable[Path], *, overwrite: bool) -> None:
    """Refuse output files that exist or cannot be written. The folder of a single file has to exist."""
    one = isinstance(files, Path)
    for file in [files] if isinstance(files, Path) else files:
        folder = file.absolute().parent
        if file.is_dir():
            raise UsageError(f"{flag} {file} is a directory; give a file, such as {file / 'report'}")
        if file.exists() and not overwrite:
            raise UsageError(f"{flag} {file} exists; replace it with --overwrite, or give another path")
        if one and not folder.is_dir():
            raise UsageError(f"{flag} {file}: there is no directory {folder}; create it first")
        _require_writable(flag, nearest_directory(folder))


def require_unused_reports(out: Path | None, html: Path | None, *, overwrite: bool) -> None:
    """Refuse files of --out and --html that exist or cannot be written."""
    for flag, file in (("--out", out), ("--html", html)):
        if file is not None:
            require_unused_paths(flag, file, overwrite=overwrite)


def write_json_report(report: Mapping[str, Any], out: Path | None) -> None:
    """Write a report as JSON to the file of --out, if given, and a note to stderr."""
    if out is None:
        return
    from yamsim_cli.core.files.documents.json_text import json_text

    write_output(out, json_text(report).encode())
    print_note(f"Written to {out}.")


def _require_writable(flag: str, folder: Path) -> None:
    if not os.access(folder, os.W_OK | os.X_OK):
        raise ResourceError(f"{flag}: {folder} cannot be written to; choose another path")
    free = shutil.disk_usage(folder).free
    if free < MIN_FREE_BYTES:
        raise ResourceError(f"{flag}: {folder} has {free} bytes left; free some space, or choose another path")
