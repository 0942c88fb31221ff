"""Recording on a Ray cluster: the same bytes as with local processes, whatever happens to a node."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from tests.e2e.recorder import digest, episodes, run, start, wait_until

pytestmark = [pytest.mark.render, pytest.mark.slow]


def test_the_same_bytes_as_processes_write(tmp_path: Path) -> None:
    pytest.importorskip("ray")
    assert run(tmp_path / "processes", "--n", "3", "--workers", "1")[0] == 0
    code, err = run(tmp_path / "ray", "--n", "3", "--workers", "2", "--executor", "ray")
    assert (code, err) == (0, ""), err
    assert digest(tmp_path / "ray") == digest(tmp_path / "processes")


@pytest.mark.long
def test_ctrl_c_finishes_what_is_in_hand_and_resume_goes_on(tmp_path: Path) -> None:
    pytest.importorskip("ray")
    out = tmp_path / "stopped"
    with start(out, "--n", "6", "--executor", "ray") as process:
        wait_until(lambda: episodes(out))
        os.kill(process.pid, signal.SIGINT)
        _, err = process.communicate(timeout=600)
    assert process.returncode == 130, err
    left = episodes(out)
    assert 0 < len(left) < 6
    assert run(out, "--n", "6", "--resume")[0] == 0
    assert run(tmp_path / "whole", "--n", "6")[0] == 0
    assert digest(out) == digest(tmp_path / "whole")


def test_an_address_without_ray_is_refused(tmp_path: Path) -> None:
    code, err = run(tmp_path / "d", "--address", "auto")
    assert code == 2
    assert "--address needs --executor ray" in err
