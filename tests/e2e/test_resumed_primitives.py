"""A dataset with primitives continues with primitives, even if meshes exist meanwhile."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.cli.run_cli import yamsim
from yamsim_cli.core.config.mesh_provenance import PRIMITIVES_ONLY
from yamsim_cli.core.dataset.reader import open_episodes
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.session_opener import SessionOpener

pytestmark = [pytest.mark.render, pytest.mark.slow]

RECORD = ("record", "--size", "64x48", "--quality", "fast", "--seed", "1", "--workers", "1")


def test_a_dataset_of_primitives_goes_on_when_the_meshes_are_here(locations: Locations, tmp_path: Path) -> None:
    opener = SessionOpener({"YAMSIM_OFFLINE": "1"}, lambda text: None, str)
    if None in opener.with_mesh_folders(locations, ["i2rt_yam_crank", "ycb"]).meshes.values():
        pytest.skip("the meshes of i2rt_yam_crank and ycb are not here: yamsim assets fetch")
    dataset = tmp_path / "dataset"
    bare = {"YAMSIM_ASSETS": str(tmp_path / "none")}
    first = yamsim(*RECORD, "--n", "1", "--out", dataset, env=bare)
    assert first.code == 0, first.err
    # Here, the meshes are those of the user.
    second = yamsim(*RECORD, "--n", "2", "--out", dataset, "--resume", env={"YAMSIM_ASSETS": str(locations.assets)})
    assert second.code == 0, second.err
    said = [episode.record.meshes for episode in open_episodes(dataset)]
    assert said == [{"i2rt_yam_crank": PRIMITIVES_ONLY, "ycb": PRIMITIVES_ONLY}] * 2
    again = yamsim("verify", dataset, "--images", env=os.environ)
    assert again.code == 0, again.err
