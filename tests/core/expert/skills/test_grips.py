"""Grips: how a hand can hold an object."""

from __future__ import annotations

import math

import numpy as np

from yamsim_cli.api import API_SESSION_OPENER
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.objects.object_config import ObjectConfig
from yamsim_cli.core.expert.skills.grasp_candidates import sideways_candidates


def _item(name: str) -> ObjectConfig:
    return load_config(ObjectConfig, "objects", name, API_SESSION_OPENER.find_locations())


def test_a_hand_leans_to_the_side_about_narrow_things_alone() -> None:
    """Along the closing axis, so that a wall beside the fingers is not in the way."""
    assert not list(sideways_candidates(_item("kitchen_cup")))
    fork = _item("kitchen_fork")
    assert fork.grasp is not None
    found = list(sideways_candidates(fork))
    # A fork lies along y: fingers close along x, and the hand comes from above, tilted along x.
    leans = {round(math.degrees(math.asin(np.clip(grip.T_pinch_in_thing[0, 2], -1, 1)))) for grip in found}
    assert {0, 20, -20, 35, -35, 50, -50} <= leans
    assert all(grip.clearance < fork.grasp.clearance for grip in found)
    for grip in found:
        assert np.allclose(grip.T_pinch_in_thing[:3, :3] @ grip.T_pinch_in_thing[:3, :3].T, np.eye(3))
