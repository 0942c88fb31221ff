"""What all tests share. MuJoCo reads MUJOCO_GL when first imported: it is settled here, before any test module."""

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
# Tests that fetch at first use unset it, and have a package index of their own.
os.environ["YAMSIM_OFFLINE"] = "1"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    # By far the longest one begins first, so that nothing waits for it at the end.
    items.sort(key=lambda item: "test_pages.py" not in item.nodeid)
    # `make test` sees to a backend, so a machine that runs the suite by other means is told rather than failed.
    if os.environ["YAMSIM_TEST_GL"] == "none":
        for item in items:
            if item.get_closest_marker("render"):
                item.add_marker(pytest.mark.skip(reason="no OpenGL backend works here: tools/ensure_gl.sh"))


@pytest.fixture(scope="session")
def locations() -> Locations:
    return Locations.find(os.environ)


@pytest.fixture(scope="session")
def make_config(locations: Locations) -> Callable[..., RecordConfig]:
    """The default recording with some values changed: `make_config({("image", "size_px"): [64, 48]})`."""

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
