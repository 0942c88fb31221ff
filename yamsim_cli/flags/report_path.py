"""Reports as pages: where they may be written."""

from __future__ import annotations

from pathlib import Path

from yamsim_cli.core.errors import UsageError


def require_free(path: Path, overwrite: bool) -> None:
    """Refuse a report's path before the work rather than after it.

    Raises:
        UsageError: something is there, or there is no directory for it.
    """
    if path.is_dir():
        raise UsageError(f"--html {path} is a directory; give a file, such as {path / 'report.html'}")
    if path.exists() and not overwrite:
        raise UsageError(f"--html {path} exists; replace it with --overwrite, or give another file")
    if not path.absolute().parent.is_dir():
        raise UsageError(f"--html {path}: there is no directory {path.absolute().parent}; make it first")
