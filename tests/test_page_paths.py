"""Paths in the repository that the pages name in backticks exist."""

from __future__ import annotations

import re
from pathlib import Path

_ROOT = Path(__file__).parents[1]
_PATH = re.compile(r"`((?:robot_models|configs|yamsim_cli|core|tools|tests|assets|docs|integrations)/[\w./-]+)`")


def missing(text: str) -> list[str]:
    """Paths in backticks that are in neither the repository nor the package, whose name pages omit."""
    return [
        path
        for path in _PATH.findall(text)
        if not (_ROOT / path).exists() and not (_ROOT / "yamsim_cli" / path).exists()
    ]


def test_paths_that_pages_name_exist() -> None:
    pages = [_ROOT / "README.md", _ROOT / "CONTRIBUTING.md", *sorted((_ROOT / "docs").glob("*.md"))]
    texts = {page.name: page.read_text(encoding="utf-8") for page in pages}
    assert sum(len(_PATH.findall(text)) for text in texts.values()) > 20
    assert {name: paths for name, text in texts.items() if (paths := missing(text))} == {}


def test_a_path_that_does_not_exist_is_found() -> None:
    text = "`robot_models/i2rt_yam/limits.yaml` `core/no_such.py` `core/errors.py` `README.md`"
    assert missing(text) == ["robot_models/i2rt_yam/limits.yaml", "core/no_such.py"]
