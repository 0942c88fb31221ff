"""Update the table in docs/clients.md: `python -m tests.clients.table` after `make test-clients`.

A row whose tests all passed gets their version and date; a row that was not run stays. After a failed test, the test is
named, and the table stays.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterable, Mapping

from tests.clients.environments import REPOSITORY
from tests.clients.rows import ROWS

PAGE = REPOSITORY / "docs" / "clients.md"
RESULTS = REPOSITORY / "out" / "clients.jsonl"

_HEAD = "| client | version | tested use | passed |\n|---|---|---|---|\n"
_TABLE = re.compile(re.escape(_HEAD) + r"(?:\|.*\n)*")
_ROW = re.compile(r"^\| (.*?) \| (.*?) \| (.*?) \| (.*?) \|$", re.MULTILINE)

# Version of a row, and day of its last success.
Passed = Mapping[str, tuple[str, str]]


def shown(text: str) -> dict[str, tuple[str, str]]:
    """Return client -> version and date of the table in a text."""
    found = _TABLE.search(text)
    rows = _ROW.findall(found.group()[len(_HEAD) :]) if found else []
    return {client: (version, date) for client, version, _, date in rows}


def rendered(passed: Passed) -> str:
    """Return the table of all rows in order. `passed` is client -> version and date, if it has passed."""
    lines = []
    for row in ROWS.values():
        version, date = passed.get(row.client, ("-", "never"))
        lines.append(f"| {row.client} | {version} | {row.opens} | {date} |\n")
    return _HEAD + "".join(lines)


def results(lines: Iterable[str]) -> tuple[dict[str, tuple[str, str]], list[str]]:
    """Return client -> version and date of clients whose tests all passed, and the failed tests."""
    records = [json.loads(line) for line in lines]
    failed = sorted({record["test"] for record in records if not record["passed"]})
    bad = {record["row"] for record in records if not record["passed"]}
    return {
        ROWS[record["row"]].client: (record["version"], record["date"])
        for record in records
        if record["row"] in ROWS and record["row"] not in bad
    }, failed


def main() -> None:
    """Write the table into its page."""
    passed, failed = results(RESULTS.read_text(encoding="utf-8").splitlines())
    if failed:
        sys.exit("the table of clients stays as it is; these failed:\n" + "\n".join(failed))
    text = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(_TABLE.sub(lambda _: rendered(shown(text) | passed), text), encoding="utf-8")


if __name__ == "__main__":
    main()
