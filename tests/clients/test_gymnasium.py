"""The environment in the oldest and the newest gymnasium that the extra admits."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.clients.environments import Interpreter
from tests.pages import snippet

pytestmark = [pytest.mark.client, pytest.mark.render]


def test_the_oldest_checker_passes_the_environment(client: Callable[[str], Interpreter]) -> None:
    """The newest checker runs in tests/test_gym_env.py."""
    interpreter = client("gymnasium-1.0")
    assert interpreter.run("gymnasium_check.py")["version"] == interpreter.version("gymnasium")


@pytest.mark.parametrize("row", ["gymnasium-1.0", "gymnasium"])
def test_images_from_processes_of_their_own(row: str, client: Callable[[str], Interpreter]) -> None:
    """A fork renders until its parent has rendered; then it is refused. Other processes go on rendering."""
    told = client(row).run("gymnasium_processes.py", timeout_s=280)
    # The same pictures, however the process was started.
    assert told["fork"] == told["forkserver"] > 5
    assert 'context="forkserver"' in told["refused"]
    assert told["seconds"] < 60


def test_readmes_lines_run(client: Callable[[str], Interpreter], tmp_path: Path) -> None:
    script = tmp_path / "several.py"
    script.write_text(snippet("python", "vectorization_mode"))
    done = client("gymnasium").call([str(script)])
    assert done.returncode == 0, done.stderr
