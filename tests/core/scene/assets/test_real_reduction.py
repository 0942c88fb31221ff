"""Acceptance test of reduced meshes, on the real ones: deviation and outlines."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

import pytest

from tests.silhouettes import DIRECTIONS, PIXELS, Silhouettes, overlap
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.stl import decode_stl
from yamsim_cli.core.geometry.surface_distance import hausdorff_distance
from yamsim_cli.core.scene.assets import AssetStore, load_lock, make_reduced

LOCATIONS = Locations.from_environment(os.environ)
LOCK = load_lock(LOCATIONS)
# Generated meshes have few faces anyway.
FILES = [(name, file) for name, assets in LOCK.sets.items() if assets.archive is not None for file in assets.files]
# The largest file of each set: distances to all of them would take minutes.
LARGEST = {name: max(LOCK.sets[name].files.items(), key=lambda file: file[1].size)[0] for name, _ in FILES}

# Most faces of a whole set: the crank arm has 104,574, the big arm 199,418, banana and plate 16,384 each.
MOST = {
    "i2rt_yam_crank": 15_000,
    "i2rt_yam_linear_4310": 5_600,
    "i2rt_arm_yam": 6_700,
    "i2rt_arm_yam_ultra": 6_700,
    "i2rt_arm_big_yam": 7_500,
    "i2rt_gripper_crank_4310": 15_300,
    "i2rt_gripper_flexible_4310": 28_600,
    "i2rt_station_cameras": 4_900,
    "finray": 320,
    "ycb": 4_600,
    "ycb_small": 11_500,
    "ycb_objects": 52_000,
}


# With fewer faces, thin parts of these deviate by more than half a millimetre.
LARGE_SHARES = {
    ("i2rt_gripper_crank_4310", "tip_left.stl"): 0.66,
    ("i2rt_gripper_crank_4310", "tip_right.stl"): 0.56,
}


@cache
def folders(name: str) -> tuple[Path, Path]:
    """Folder of a set, and that of its reduced meshes."""
    assets, store = LOCK.sets[name], AssetStore(LOCATIONS.assets)
    source = store.find_verified_folder(assets)
    if source is None:
        pytest.skip(f"the meshes of {name} are not here: yamsim assets fetch")
    return source, make_reduced(store, assets, source, LOCK.notices[assets.notice]).directory


def meshes(name: str, file: str) -> list[tuple]:
    """Source and reduced mesh, in mm."""
    read = [decode_stl((folder / file).read_bytes()) for folder in folders(name)]
    return [(vertices * 1000, faces) for vertices, faces in read]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "file"), LARGEST.items())
def test_no_point_strays_by_half_a_millimetre(name: str, file: str) -> None:
    source, reduced = meshes(name, file)
    assert len(reduced[1]) < LARGE_SHARES.get((name, file), 0.45) * len(source[1])
    assert hausdorff_distance(source, reduced, 1.0, 20_000) <= 0.5


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.parametrize(("name", "file"), FILES)
def test_outlines_stay(name: str, file: str) -> None:
    """Each mesh alone fills the picture: in a scene it would be a tenth as large."""
    source, reduced = meshes(name, file)
    camera = Silhouettes(source[0])
    outlines = camera.of(*source)
    assert outlines.shape == (DIRECTIONS, PIXELS, PIXELS) == (12, 512, 512)
    assert outlines.any(axis=(1, 2)).all()
    assert overlap(outlines, camera.of(*reduced)) >= 0.995


@pytest.mark.parametrize("name", LOCK.sets)
def test_few_faces_are_left(name: str) -> None:
    folder = folders(name)[1]
    assert sum(len(decode_stl(path.read_bytes())[1]) for path in folder.glob("*.stl")) <= MOST[name]
