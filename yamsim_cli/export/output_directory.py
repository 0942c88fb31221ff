"""Output directory of an export, which becomes visible only when complete."""

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
    """Result of an export.

    Attributes:
        path: the output directory or file.
        episodes, frames: numbers of exported episodes and frames.
        moved_aside: path of the backup of an earlier output at `path`; None if there was none.
        notes: lines for the user on where the export differs from the recording.
    """

    path: Path
    episodes: int
    frames: int
    moved_aside: Path | None = None
    notes: tuple[str, ...] = ()


@contextmanager
def export_directory(final: Path, *, overwrite: bool) -> Iterator[StagedDirectory]:
    """Yield a temporary directory for the block to fill. If the block succeeds, the directory is renamed to `final`.

    Args:
        overwrite: whether to rename an existing `final` to a backup, once the new directory is complete. If False, an
            existing `final` that is not an empty directory is an error.

    Raises:
        UsageError: `final` is in use, or its parent directory does not exist.
        PartialJobError: a write failed. No part of the export is left.
        InterruptedJobError: the user stopped the job. No part of the export is left.
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
    """Raise UsageError if the parent directory of `out` does not exist."""
    if not out.absolute().parent.is_dir():
        raise UsageError(f"{out}: there is no directory {out.absolute().parent}; create it, or choose another OUT")
