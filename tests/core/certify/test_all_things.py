"""Every object that yamsim ships passes its certificate."""

from __future__ import annotations

import os

import pytest

from yamsim_cli.core.certify.run import certify
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.things import ObjectConfig
from yamsim_cli.core.opener import Opener
from yamsim_cli.core.resources import Locations

pytestmark = pytest.mark.slow

WHERE = Locations.find(os.environ)


@pytest.mark.parametrize("name", WHERE.config_names("objects"))
def test_it_passes(name: str) -> None:
    item = load_config(ObjectConfig, "objects", name, WHERE)
    meshes = Opener(os.environ, lambda text: None, str).find_meshes(WHERE, item.mesh_sets).meshes
    certified = certify(item, meshes, WHERE)
    assert {code: outcome.note for code, outcome in certified.outcomes.items() if outcome.ok is False} == {}
    if item.shape is not None or (meshes and all(meshes.values())):
        # What can be made of every thing that has meshes was made.
        made = {code for code, outcome in certified.outcomes.items() if outcome.ok}
        assert made >= {"mesh.open", "mesh.inverted", "mass.density", "collision.differs", "rest.moves", "drop.breaks"}
