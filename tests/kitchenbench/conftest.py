"""The station without images, for all tests of KitchenBench."""

from __future__ import annotations

from typing import Any

import pytest


@pytest.fixture(scope="module")
def base() -> Any:
    pytest.importorskip("kitchenbench", reason="needs yamsim[inspect]")
    from yamsim_cli.kitchenbench.benchmark_scene import open_station_session

    return open_station_session("64x48", images=False)
