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
    """Result of an export; `notes` describe its differences from the recording for the user."""

    path: Path
    episodes: int
    frames: int
    moved_aside: Path | None = None
    notes: tuple[str, ...] = ()


@contextmanager
def export_directory(final: Path, *, overwrite: bool) -> Iterator[StagedDirectory]:
    """Yield a temporary directory to fill. If the block succeeds, it is renamed to `final`.

    With `overwrite`, an existing `final` is then renamed to a backup. Otherwise, only an empty directory is replaced.
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
