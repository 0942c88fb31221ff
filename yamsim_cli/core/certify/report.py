"""Write a certificate's page: draw, and publish it whole or not at all."""

from __future__ import annotations

import datetime
from pathlib import Path

from ... import __version__
from ..errors import ResourceError
from ..files import write_file
from ..report.certificate_page import certificate_page
from .codes import CHECKS
from .pictures import draw
from .run import Certified


def write_page(certified: Certified, path: Path) -> None:
    """Write the page, replacing what is there.

    Raises:
        ResourceError: nothing can be drawn here, or the file cannot be written.
    """
    titles = {code: (check.title, check.advice) for code, check in CHECKS.items()}
    made = f"Made by yamsim {__version__} on {datetime.date.today().isoformat()}."
    text = certificate_page(certified.plain(), titles, draw(certified.outcomes), made)
    try:
        write_file(path, text.encode())
    except OSError as error:
        raise ResourceError(f"{path} cannot be written: {error.strerror}; choose another --html") from error
