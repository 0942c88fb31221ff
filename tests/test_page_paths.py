"""Paths in the repository that the pages name in backticks exist."""

from __future__ import annotations

import re
from pathlib import Path

_ROOT = Path(__file__).parents[1]
_PATH = re.compile(r"`((?:robot_models|configs|yamsim_cli|tools|tests|assets|docs|integrations)/[\w./-]+)`")


def test_paths_that_pages_name_exist() -> None:
    pages = [_ROOT / "README.md", _ROOT / "CONTRIBUTING.md", *sorted((_ROOT / "docs").glob("*.md"))]
    named = [(page.name, path) for page in pages for path in _PATH.findall(page.read_text(encoding="utf-8"))]
    assert len(named) > 20
    assert [(page, path) for page, path in named if not (_ROOT / path).exists()] == []
