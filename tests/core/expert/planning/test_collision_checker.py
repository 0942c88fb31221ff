"""The limit of the masks with which a collision checker separates moving from static geoms."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from yamsim_cli.core.config.goals.world import TABLE
from yamsim_cli.core.errors import SimulationError
from yamsim_cli.core.expert.planning.collision_checker import CollisionChecker


def checker(kinds: int) -> CollisionChecker:
    """A checker of an object beside a wall, in a scene with `kinds` pairs of contype and conaffinity."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="cube")
    body.add_freejoint(name="cube")
    box = {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": [0.02] * 3}
    body.add_geom(**box)
    spec.worldbody.add_geom(name=TABLE, pos=[0.1, 0, 0], **box)
    for number in range(2, kinds + 1):
        spec.worldbody.add_geom(pos=[5, 0, 0], contype=number, conaffinity=1, **box)
    return CollisionChecker(spec.compile(), [], ["cube"], [np.zeros(0, int)])


def test_kinds_of_geoms_beyond_the_bits_of_a_mask_are_refused() -> None:
    start, along = np.array([0.0, 0, 0, 1, 0, 0, 0]), np.array([1.0, 0.0])
    assert checker(31).free_distance(start, "cube", along, 0.2) == pytest.approx(0.06, abs=0.004)
    with pytest.raises(SimulationError, match="32 different pairs of contype and conaffinity; at most 31"):
        checker(32).free_distance(start, "cube", along, 0.2)
