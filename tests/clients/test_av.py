"""The oldest PyAV that yamsim allows, and versions up to the newest, which all other tests use."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.clients.environments import REPOSITORY, Interpreter

TESTS = (
    "tests/core/images/test_video.py",
    "tests/export/test_films.py",
    "tests/export/test_lerobot.py",
)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("av-15", marks=pytest.mark.client),
        pytest.param("av-16", marks=pytest.mark.client_heavy),
        pytest.param("av-17", marks=pytest.mark.client_heavy),
    ],
)
def test_videos_and_exports_are_as_with_the_newest(
    name: str, client: Callable[[str], Interpreter], tmp_path: Path
) -> None:
    interpreter = client(name)
    found = interpreter.call(["-c", "import av; print(av.__version__)"]).stdout.strip()
    assert found == interpreter.version("av") and found.startswith(name.removeprefix("av-"))
    quiet = ["-q", "-p", "no:cacheprovider", "-p", "no:xdist", f"--basetemp={tmp_path / 'inner'}"]
    done = interpreter.call(["-m", "pytest", *quiet, *TESTS], cwd=REPOSITORY)
    assert done.returncode == 0 and "skipped" not in done.stdout, done.stdout[-3000:]
