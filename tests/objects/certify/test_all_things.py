"""Every shipped object passes its certification; cloth has none."""

from __future__ import annotations

import os

import pytest

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.objects.object_config import ObjectConfig
from yamsim_cli.core.errors import UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.objects.certify.certify import run_object_checks
from yamsim_cli.session_opener import SessionOpener

pytestmark = pytest.mark.slow

WHERE = Locations.from_environment(os.environ)
# On a table, lower than the pads reach below the pinch point: `pick` drops them.
TOO_LOW = ("kitchen_dry_pasta", "kitchen_penne")
CLOTH = ("soft_cloth", "soft_dish_towel", "soft_napkin")


@pytest.mark.parametrize("name", [name for name in WHERE.config_names("objects") if name not in CLOTH])
def test_shipped_objects_pass_their_checks(name: str) -> None:
    item = load_config(ObjectConfig, "objects", name, WHERE)
    meshes = SessionOpener(os.environ, lambda text: None, str).with_mesh_folders(WHERE, item.mesh_sets).meshes
    assert item.cloth is None
    certified = run_object_checks(item, meshes, WHERE)
    assert certified.failed_codes == (("grasp.slips",) if name in TOO_LOW else ()), certified.to_json_data()
    if item.shape is not None or (meshes and all(meshes.values())):
        # All checks of objects with meshes were made.
        made = {code for code, outcome in certified.outcomes.items() if outcome.ok}
        assert made >= {"mesh.open", "mesh.inverted", "mass.density", "collision.differs", "rest.moves", "drop.breaks"}


@pytest.mark.parametrize("name", CLOTH)
def test_cloth_gets_no_certificate(name: str) -> None:
    with pytest.raises(UsageError, match="is cloth"):
        run_object_checks(load_config(ObjectConfig, "objects", name, WHERE), {}, WHERE)
