"""The directory that an export writes; it does not appear until it is whole."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ..core.dataset.disk_errors import explain_disk_error
from ..core.errors import InterruptedJobError, PartialJobError, UsageError
from ..core.files.writing import StagedDirectory, staged_directory


@dataclass(frozen=True)
class ExportResult:
    """What an export wrote.

    Attributes:
        path: the directory or file.
        episodes, frames: their numbers.
        moved_aside: new path of what was at `path` before; None if nothing was.
        notes: lines for the user on where the export differs from the recording.
    """

    path: Path
    episodes: int
    frames: int
    moved_aside: Path | None = None
    notes: tuple[str, ...] = ()


@contextmanager
def export_directory(final: Path, *, overwrite: bool) -> Iterator[StagedDirectory]:
    """A directory to fill in the block. It appears as `final` when the block ends without an error.

    Args:
        overwrite: move what is at `final` aside, once the new directory is whole, instead of refusing to start.

    Raises:
        UsageError: `final` is in use, or has no parent.
        PartialJobError: the disk refused something; nothing of the export is left.
        InterruptedJobError: stopped by the user; nothing of the export is left.
    """
    require_parent(final)
    if final.exists() and not overwrite and (not final.is_dir() or any(final.iterdir())):
        what = "is not empty" if final.is_dir() else "is not a directory"
        raise UsageError(f"{final} {what}; move it aside with --overwrite, or choose another OUT")
    try:
        with staged_directory(final, overwrite=overwrite) as stage:
            yield stage
    except OSError as error:
        raise PartialJobError(f"{explain_disk_error(error, final.parent)}: nothing was exported") from error
    except KeyboardInterrupt:
        raise InterruptedJobError(f"interrupted: nothing was written to {final}; run it again") from None


def require_parent(out: Path) -> None:
    """Refuse a path without a parent directory, before the work begins.

    Raises:
        UsageError: there is no such directory.
    """
    if not out.absolute().parent.is_dir():
        raise UsageError(f"{out}: there is no directory {out.absolute().parent}; make it, or choose another OUT")
