"""Common fixtures. MuJoCo reads MUJOCO_GL at its import, so the variable is set here, before any test module."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.known_gl import remember_backend, settle_backend
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.files.resources import Locations

settle_backend()
remember_backend()
# Tests of fetching unset it, and have their own package index.
os.environ["YAMSIM_OFFLINE"] = "1"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    # The longest test starts first, so that no worker waits for it at the end.
    items.sort(key=lambda item: "test_pages.py" not in item.nodeid)
    # `make test` provides a backend; other ways of running the suite get a message instead of a failure.
    if os.environ["YAMSIM_TEST_GL"] == "none":
        for item in items:
            if item.get_closest_marker("render"):
                item.add_marker(pytest.mark.skip(reason="no OpenGL backend works here: tools/ensure_gl.sh"))


@pytest.fixture(scope="session")
def locations() -> Locations:
    return Locations.from_environment(os.environ)


@pytest.fixture(scope="session")
def make_config(locations: Locations) -> Callable[..., RecordConfig]:
    """Return the default recording with some values changed: `make_config({("image", "size_px"): [64, 48]})`."""

    def make(changes: dict[tuple[str, ...], Any] | None = None) -> RecordConfig:
        overrides = {path: ("test", value) for path, value in (changes or {}).items()}
        return load_config(RecordConfig, "record", "default", locations, overrides)

    return make


@pytest.fixture(scope="session")
def config(make_config: Callable[..., RecordConfig]) -> RecordConfig:
    return make_config()


@pytest.fixture(scope="session")
def repository() -> Path:
    return Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def single(locations: Locations) -> RigConfig:
    return load_config(RigConfig, "rigs", "single", locations)


@pytest.fixture(scope="session")
def station(locations: Locations) -> RigConfig:
    """Two arms."""
    return load_config(RigConfig, "rigs", "yam_station_linear_4310_d405", locations)
