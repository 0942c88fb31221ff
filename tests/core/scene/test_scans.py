"""The primitives that stand for a scan in contacts: as large as it, and where it is."""

from __future__ import annotations

import numpy as np
import pytest

from yamsim_cli.core.assets import AssetStore, load_lock
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.record import RecordConfig
from yamsim_cli.core.config.scene import Capsule, Cylinder, ObjectConfig
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.geometry.stl import read_stl
from yamsim_cli.core.resources import Locations

# By how much (m) a scan may stick out of its primitives, and they out of its box.
FITS = {
    "tomato_soup_can": 0.002,
    "tuna_can": 0.002,
    # Its shoulders.
    "apple": 0.007,
    "orange": 0.003,
    "lemon": 0.007,
    "mug": 0.006,
}


def outside(item: ObjectConfig, points: Array) -> Array:
    """How far points (n, 3) in the object's frame lie outside of its nearest primitive, m; negative inside."""
    distances = []
    for part in item.collision:
        if isinstance(part, Capsule):
            start, along = np.array(part.start), np.subtract(part.end, part.start)
            share = np.clip((points - start) @ along / (along @ along), 0, 1)
            distances.append(np.linalg.norm(points - start - share[:, None] * along, axis=1) - part.radius)
        else:
            assert isinstance(part, Cylinder)
            x, y, z = (points - part.centre).T
            distances.append(np.maximum(np.hypot(x, y) - part.radius, np.abs(z) - part.half_height))
    return np.asarray(np.min(distances, axis=0))


@pytest.mark.parametrize("name", FITS)
def test_primitives_fit_their_scan(name: str, locations: Locations) -> None:
    item = load_config(ObjectConfig, "objects", name, locations)
    folder = AssetStore(locations.assets).resolve(load_lock(locations).sets[item.mesh.set])
    if folder is None:
        pytest.skip(f"the meshes of {item.mesh.set} are not here: yamsim assets fetch")
    points = read_stl((folder / item.mesh.file).read_bytes())[0] - item.mesh.origin
    assert abs(points[:, 2].min() + item.rest_height) < 0.001
    assert np.percentile(outside(item, points), 99) < FITS[name]
    low, high = points.min(axis=0), points.max(axis=0)
    for x, y, radius in item.footprint:
        assert (np.array([x, y]) - radius > low[:2] - FITS[name]).all()
        assert (np.array([x, y]) + radius < high[:2] + FITS[name]).all()


def test_every_distractor_is_tested(locations: Locations) -> None:
    config = load_config(RecordConfig, "record", "default", locations, {("randomization",): ("test", "default")})
    assert {item.name for item in config.randomization.extras} <= FITS.keys()
