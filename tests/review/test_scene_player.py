"""The 3D scene of an episode, in a process of its own."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from yamsim_cli.core.errors import ResourceError
from yamsim_cli.review.scene_player import ScenePlayer

# Stands in for `yamsim replay`: it names its process in the address, talks more than a pipe holds, and waits.
_STAND_IN = """
import os, signal, sys
print(f"http://127.0.0.1:{os.getpid()}/  (Ctrl-C ends)", flush=True)
print("x" * 200_000, flush=True)
sys.stderr.write("y" * 200_000)
open(sys.argv[1], "w").close()
signal.pause()
"""


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_one_episode_plays_at_a_time(tmp_path: Path) -> None:
    with ScenePlayer([sys.executable, "-c", _STAND_IN]) as player:
        first = int(player.play(tmp_path / "said").rsplit(":", 1)[1].strip("/"))
        while not (tmp_path / "said").exists():
            assert is_running(first), "a full pipe stops it"
        second = int(player.play(tmp_path / "other").rsplit(":", 1)[1].strip("/"))
        assert (is_running(first), is_running(second)) == (False, True)
    assert not is_running(second)


def test_a_player_that_cannot_start_says_why(tmp_path: Path) -> None:
    fails = "import sys; sys.exit('yamsim: the extra yamsim[view] is not installed')"
    player = ScenePlayer([sys.executable, "-c", fails])
    with pytest.raises(ResourceError, match=r"cannot be shown: yamsim: the extra yamsim\[view\]"):
        player.play(tmp_path)
    player.close()
