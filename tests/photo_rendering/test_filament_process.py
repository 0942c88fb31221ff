"""The process of Filament, with a renderer that hangs and ends as tests ask for. Needs no Vulkan driver."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.photo_rendering.fake_filament import LOCK_VARIABLE
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.core.images.image import Image
from yamsim_cli.photo_rendering import filament_process
from yamsim_cli.photo_rendering.filament_process import FilamentProcess

SIZE = (4, 3)
BACKGROUND = np.full((3, 4, 3), 99, np.uint8)
END_SECONDS = 30  # s, within which a process must have ended


def open_process() -> tuple[FilamentProcess, mujoco.MjData]:
    filament_process.require_filament = lambda: "A GPU"  # type: ignore[assignment]
    filament_process.version = lambda name: "1"  # type: ignore[assignment]
    filament_process.__name__ = "tests.photo_rendering.fake_filament"  # the module that the process runs
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    return FilamentProcess(model, SIZE, 1), mujoco.MjData(model)


@pytest.fixture
def render(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Image]]:
    for name in ("require_filament", "version", "__name__"):
        monkeypatch.setattr(filament_process, name, getattr(filament_process, name))  # restored after the test
    process, data = open_process()

    def render_one(camera: str, background: Callable[[], Image] = lambda: BACKGROUND) -> Image:
        return process.render(data, camera, background)

    render_one.process = process  # type: ignore[attr-defined]
    yield render_one
    process.close()


@pytest.mark.parametrize("error", [KeyboardInterrupt(), ValueError("no sky"), OSError("no file")])
def test_an_error_of_the_background_leaves_no_image_for_the_next_call(
    render: Callable[..., Image], error: BaseException
) -> None:
    def fail() -> Image:
        raise error

    with pytest.raises(type(error)) as caught:
        render("background", fail)
    assert caught.value is error
    assert (render("7") == 7).all()
    assert (render("background") == BACKGROUND).all()


def test_the_reason_is_that_of_the_process_that_ended(render: Callable[..., Image]) -> None:
    with pytest.raises(ResourceError, match=r"Filament of mujoco-studio 1, A GPU ended with code 3 \(no more memory\)"):
        render("abort")
    with pytest.raises(ResourceError, match=r"ended with code 3 \(it left no message\)"):
        render("exit")
    assert (render("7") == 7).all()


def test_a_process_that_hangs_is_killed(render: Callable[..., Image], monkeypatch: pytest.MonkeyPatch) -> None:
    render("1")
    process = render.process._process  # type: ignore[attr-defined]
    monkeypatch.setattr(filament_process, "_ANSWER_SECONDS", 0.2)
    with pytest.raises(ResourceError, match=r"hangs: no answer after 0.2 s; run `yamsim doctor`"):
        render("hang")
    assert process.returncode == -9


def test_ctrl_c_in_the_terminal_does_not_reach_the_process(render: Callable[..., Image]) -> None:
    render("1")
    assert os.getpgid(render.process._process.pid) != os.getpgid(0)  # type: ignore[attr-defined]


def test_the_process_ends_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    lock = tmp_path / "lock"
    program = (
        "from tests.photo_rendering.test_filament_process import open_process\n"
        "process, data = open_process()\n"
        "process.render(data, 'hang', None)\n"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", program],
        env={**os.environ, LOCK_VARIABLE: str(lock), "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
    )
    try:
        assert comes_true(lambda: lock.exists() and lock.read_text() == "locked")
        assert not is_free(lock)
    finally:
        parent.kill()
        parent.wait()
    assert comes_true(lambda: is_free(lock))


def comes_true(condition: Callable[[], bool]) -> bool:
    end = time.monotonic() + END_SECONDS
    while not (met := condition()) and time.monotonic() < end:
        time.sleep(0.05)
    return met


def is_free(lock: Path) -> bool:
    with lock.open() as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return False
    return True


def test_memory_of_the_parent_does_not_count() -> None:
    """Otherwise each image of a large process would start another process."""
    size = 700_000_000
    large = bytearray(size)
    large[::4096] = b"1" * len(large[::4096])
    program = "from yamsim_cli.photo_rendering.filament_process import _used_bytes; print(_used_bytes())"
    child = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert 10_000_000 < int(child.stdout) < size
    del large
