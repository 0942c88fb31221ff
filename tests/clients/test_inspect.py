"""KitchenBench on our station, by Inspect Robots."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.clients.environments import REPOSITORY, Interpreter

pytestmark = [pytest.mark.client, pytest.mark.render]


def test_its_tests_pass(client: Callable[[str], Interpreter]) -> None:
    """They are skipped where the packages are not installed; here they are."""
    arguments = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/kitchenbench"]
    done = client("inspect-robots").call(arguments, timeout_s=900, cwd=REPOSITORY)
    assert done.returncode == 0, done.stdout
    assert "skipped" not in done.stdout
