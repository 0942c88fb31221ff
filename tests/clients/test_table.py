"""The table of clients in docs/clients.md agrees with the rows of the tests; runs no client."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.clients import table
from tests.clients.rows import ROWS, ClientRow

HERE = Path(__file__).parent


def test_the_page_has_the_table() -> None:
    text = table.PAGE.read_text(encoding="utf-8")
    assert table.rendered(table.shown(text)) in text, "python -m tests.clients.table, after make test-clients"


@pytest.mark.parametrize("key", ROWS)
def test_every_row_has_passed_in_a_test_that_names_it(key: str) -> None:
    text = table.PAGE.read_text(encoding="utf-8")
    version, date = table.shown(text)[ROWS[key].client]
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", date) and version != "-"
    tests = [path for path in HERE.glob("test_*.py") if f'"{key}"' in path.read_text(encoding="utf-8")]
    assert tests, f"no test in tests/clients opens {key!r}"


def test_a_row_whose_tests_passed_gets_their_version(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table, "ROWS", {"a": ClientRow("A", "a", "reads"), "b": ClientRow("B", "b", "writes")})
    lines = [
        '{"row": "a", "version": "1", "passed": true, "date": "2026-11-01", "test": "x"}',
        '{"row": "b", "version": "2", "passed": true, "date": "2026-11-01", "test": "y"}',
        '{"row": "b", "version": "2", "passed": false, "date": "2026-11-01", "test": "z"}',
    ]
    passed, failed = table.results(lines)
    assert passed == {"A": ("1", "2026-11-01")} and failed == ["z"]
    text = table.rendered(passed | {"B": ("1", "2026-10-01")})
    assert table.shown(text) == {"A": ("1", "2026-11-01"), "B": ("1", "2026-10-01")}
