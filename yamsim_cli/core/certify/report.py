"""Write a certificate's page: draw, and publish it whole or not at all."""

from __future__ import annotations

from pathlib import Path

from ..report import markup
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
    text = certificate_page(certified.plain(), titles, draw(certified.outcomes), markup.made_line())
    markup.write_page(text, path)
