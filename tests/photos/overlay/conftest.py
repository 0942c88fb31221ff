from __future__ import annotations

import pytest

from tests.rig_photos import CAMERA, JOINTS, RigPhoto, RigPhotographer, looking
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.files.resources import Locations


@pytest.fixture(scope="session")
def russet_shot(locations: Locations) -> RigPhoto:
    """Both arms and both boards of russet; use it only in tests marked `render`."""
    with RigPhotographer("russet", locations, CAMERA) as studio:
        return studio.shoot(looking((0.95, -0.12, 0.7), (0.08, 0.0, 0.1)), JOINTS)


@pytest.fixture(scope="session")
def single(locations: Locations) -> RigConfig:
    return load_config(RigConfig, "rigs", "single", locations)


@pytest.fixture(scope="session")
def russet(locations: Locations) -> RigConfig:
    return load_config(RigConfig, "rigs", "russet", locations)
