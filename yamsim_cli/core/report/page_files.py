"""Pages on the disk: what stands at their foot, and how they are written whole or not at all."""

from __future__ import annotations

import datetime
from pathlib import Path

from ... import __version__
from ..files import write_output


def made_line() -> str:
    """A line for the foot of a page: by what it was made, and when."""
    return f"Made by yamsim {__version__} on {datetime.date.today().isoformat()}."


def write_page(text: str, path: Path) -> None:
    """Write a page, replacing what is there.

    Raises:
        ResourceError: the file cannot be written.
    """
    write_output(path, text.encode(), "--html")
