from __future__ import annotations

import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.e2e.browser import CHROMEDRIVER, CHROMIUM, Browser, answers, wait_until


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Browser]:
    if not (CHROMIUM.exists() and CHROMEDRIVER.exists()):
        pytest.skip("chromium and chromium-driver are not here: tools/ensure_test_programs.sh")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    driver = subprocess.Popen([CHROMEDRIVER, f"--port={port}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        wait_until(lambda: answers(port))
        client = Browser(port, tmp_path / "profile")
        yield client
        client.close()
    finally:
        driver.terminate()
        driver.wait(10)


@pytest.fixture(scope="session")
def screens(repository: Path) -> Path:
    """Where pictures of screens are kept for people to look at; git does not know it."""
    return repository / "out" / "screens"
