"""Drawing and forks: what would hang is refused, what works goes on working. Each case in an interpreter of its own."""

from __future__ import annotations

import subprocess
import sys

import pytest

# An interpreter that has drawn nothing yet; `child` tells what a function does in a process forked from here.
SCRIPT = """
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
import mujoco
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.core.vision.renderer import SceneRenderer

SCENE = "<mujoco><worldbody><light pos='0 0 3'/><geom size='1'/><camera name='c' pos='0 -5 0' xyaxes='1 0 0 0 0 1'/>"
model = mujoco.MjModel.from_xml_string(SCENE + "</worldbody></mujoco>")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)


def draw(renderer=None):
    try:
        return f"drew {(renderer or SceneRenderer(model, (32, 24))).render(data, 'c').std() > 5}"
    except ResourceError as error:
        return f"refused: {error}"


def draw_with_the_parents():
    return draw(mine)


def child(function, *arguments):
    with ProcessPoolExecutor(1, multiprocessing.get_context("fork")) as pool:
        return pool.submit(function, *arguments).result(timeout=30)


"""


def told(script: str) -> list[str]:
    """The lines that a script prints after `SCRIPT`."""
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT + script], capture_output=True, text=True, timeout=100, check=False
    )
    assert run.returncode == 0, run.stderr
    return run.stdout.splitlines()


@pytest.mark.render
def test_a_process_forked_from_one_that_drew_is_refused_with_what_to_do() -> None:
    lines = told(
        "mine = SceneRenderer(model, (32, 24))\n"
        "print(draw(mine))\n"
        "print(child(draw))\n"
        "print(child(draw_with_the_parents))\n"
        "print(child(child, draw))\n"
        "mine.close()\n"
        "print(child(draw))\n"
        "print(draw())\n"
    )
    # The parent itself goes on drawing.
    assert (lines[0], lines[-1]) == ("drew True", "drew True")
    assert len(lines) == 6
    for line in lines[1:-1]:
        assert line.startswith("refused: process ")
        assert 'context="forkserver"' in line and "'spawn'" in line


@pytest.mark.render
def test_what_mujocos_own_renderer_drew_counts() -> None:
    lines = told("theirs = mujoco.Renderer(model, 16, 16)\nprint(child(draw))\nprint(draw())\n")
    assert lines[0].startswith("refused: ")
    assert lines[1] == "drew True"


@pytest.mark.render
def test_forks_of_what_has_drawn_nothing_draw() -> None:
    assert told("print(child(draw))\nprint(child(child, draw))\nprint(draw())\n") == ["drew True"] * 3
