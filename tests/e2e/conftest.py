from __future__ import annotations

import os
import shutil
import socket
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.e2e.browser import CHROMEDRIVER, CHROMIUM, Browser, answers, wait_until
from yamsim_cli.core.files.writing import exclusive_lock


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Browser]:
    if not (CHROMIUM.exists() and CHROMEDRIVER.exists()):
        pytest.skip("chromium and chromium-driver are not here: tools/ensure_test_programs.sh")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    # One at a time: two browsers that render without a GPU slow each other down until a timeout.
    with exclusive_lock(Path(tempfile.gettempdir()) / "yamsim-tests-browser.lock"):
        yield from _drive(port, tmp_path / "profile")


def _drive(port: int, profile: Path) -> Iterator[Browser]:
    driver = subprocess.Popen([CHROMEDRIVER, f"--port={port}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        wait_until(lambda: answers(port))
        client = Browser(port, profile)
        yield client
        client.close()
    finally:
        driver.terminate()
        driver.wait(10)


@pytest.fixture(scope="session")
def screens(repository: Path) -> Path:
    """Folder of screenshots for people, ignored by git."""
    return repository / "out" / "screens"


@pytest.fixture
def screen() -> Iterator[str]:
    """A virtual screen's name."""
    if shutil.which("Xvfb") is None:
        pytest.skip("Xvfb is not here: tools/ensure_test_programs.sh")
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", "1280x800x24", "-nolisten", "tcp"],
        pass_fds=[write],
        stderr=subprocess.DEVNULL,
    )
    try:
        os.close(write)
        with os.fdopen(read) as pipe:
            number = pipe.readline().strip()
        yield f":{number}"
    finally:
        server.terminate()
        server.wait(10)
