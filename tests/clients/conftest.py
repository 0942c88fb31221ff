from __future__ import annotations

import datetime
import json
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import pytest

from tests.clients.environments import Interpreter, UnavailableError, checkout, commit
from tests.clients.rows import ROWS

# Row -> tested version.
_VERSIONS = pytest.StashKey[dict[str, str]]()


@pytest.fixture
def client(request: pytest.FixtureRequest) -> Callable[[str], Interpreter]:
    """Opens the environment of a row of `rows.ROWS`; skips the test if the environment is not available."""

    def open_client(name: str) -> Interpreter:
        row = ROWS[name]
        marker = "client_heavy" if row.heavy else "client"
        assert request.node.get_closest_marker(marker), f"a test of {name} needs the marker {marker}"
        try:
            repository = checkout(row.checkout) if row.checkout else None
            interpreter = row.environment.make()
        except UnavailableError as reason:
            pytest.skip(str(reason))
        version = commit(repository) if repository else interpreter.version(row.distribution)
        request.node.stash.setdefault(_VERSIONS, {})[name] = version
        return interpreter

    return open_client


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Generator[None, Any, Any]:
    # For `python -m tests.clients.table`: each test of each client, and its outcome.
    report = yield
    if call.when == "call" and not report.skipped:
        results = Path(str(item.config.rootpath)) / "out" / "clients.jsonl"
        results.parent.mkdir(exist_ok=True)
        with results.open("a", encoding="utf-8") as file:
            for name, version in item.stash.get(_VERSIONS, {}).items():
                today = datetime.datetime.now(datetime.UTC).date().isoformat()
                line = {"row": name, "version": version, "passed": report.passed, "date": today, "test": item.nodeid}
                file.write(json.dumps(line) + "\n")
    return report
