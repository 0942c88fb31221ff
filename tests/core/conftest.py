from __future__ import annotations

import pytest

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.resources import Locations


@pytest.fixture(scope="session")
def single(locations: Locations) -> RigConfig:
    return load_config(RigConfig, "rigs", "single", locations)


@pytest.fixture(scope="session")
def station(locations: Locations) -> RigConfig:
    """Two arms."""
    return load_config(RigConfig, "rigs", "yam_station_linear_4310_d405", locations)
