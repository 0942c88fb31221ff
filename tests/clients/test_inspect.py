"""KitchenBench on our station, by Inspect Robots."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.clients.environments import REPOSITORY, Interpreter

pytestmark = [pytest.mark.client, pytest.mark.render]


def test_what_the_table_says_of_it(client: Callable[[str], Interpreter]) -> None:
    """Three tests of yamsim's embodiment, which are skipped without the packages."""
    chosen = "conforms or come_to_rest or two_cups"
    arguments = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-k", chosen, "tests/kitchenbench"]
    done = client("inspect-robots").call(arguments, timeout_s=900, cwd=REPOSITORY)
    assert done.returncode == 0, done.stdout
    assert "skipped" not in done.stdout
