from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from tests.meshes import volume
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.things.primitives import Ring
from yamsim_cli.core.resources import Locations
from yamsim_cli.core.scene.build import build_scene
from yamsim_cli.core.scene.things.shapes import _ring_surface
from yamsim_cli.core.session import Session


def test_a_seen_ring_is_a_closed_surface_under_its_profile() -> None:
    ring = Ring(type="ring", inner=(0.08, 0.002), outer=(0.12, 0.032), thickness=0.004, segments=96)
    vertices, faces = _ring_surface(ring)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    # Closed and facing outwards: each edge once in either direction, and a volume that is positive.
    assert len({tuple(edge) for edge in edges}) == len(edges)
    assert {tuple(edge) for edge in edges} == {tuple(edge[::-1]) for edge in edges}
    section = 0.05 * ring.thickness
    middle = 0.1 + 0.5 * ring.thickness * 0.6
    assert volume((vertices, faces)) == pytest.approx(section * 2 * math.pi * middle, rel=2e-3)
    # Nothing of it rises over the straight line from the inner to the outer edge.
    radius = np.hypot(vertices[:, 0], vertices[:, 1])
    assert (vertices[:, 2] <= 0.002 + (radius - 0.08) * 0.75 + 1e-9).all()


def test_a_seen_ring_is_one_thing_to_draw(config: RecordConfig, locations: Locations) -> None:
    model = build_scene(Session(config, locations)).model
    names = [model.geom(k).name for k in range(model.ngeom)]
    seen = [name for name in names if name.startswith("plate_look")]
    assert seen == ["plate_look_0", "plate_look_1"]
    for name in seen:
        geom = model.geom(name)
        assert geom.type[0] == mujoco.mjtGeom.mjGEOM_MESH
        assert not geom.contype[0]
        assert not geom.conaffinity[0]
