"""Colours that pictures can tell apart: no arm is overexposed, and no two things of the apple's task share a colour."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tests.core.scene.test_shadows import AWAY, pictures, scene
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.things.thing import ObjectConfig
from yamsim_cli.core.resources import Locations

# From this level of 255 on, a channel counts as overexposed.
OVEREXPOSED = 250


def of_arms(model: mujoco.MjModel) -> list[int]:
    """Geoms of links: of bodies that some joint moves, without the loose box and what lies free."""
    roots = {model.body_rootid[model.jnt_bodyid[k]] for k in range(model.njnt) if model.jnt_type[k] != 0}
    return [k for k in range(model.ngeom) if model.body_rootid[model.geom_bodyid[k]] in roots]


@pytest.mark.parametrize("rig", ["single", "yam_station_linear_4310_d405"])
def test_no_arm_is_overexposed(rig: str) -> None:
    model, config, _ = scene(rig, "fast")
    seen = 0
    for name, (colours, geoms) in pictures(model, config, AWAY).items():
        arm = colours[np.isin(geoms, of_arms(model))]
        seen += len(arm)
        assert (arm >= OVEREXPOSED).any(axis=-1).mean() < 0.01 if len(arm) else True, name
    assert seen > 1000


def test_apple_and_bowl_differ_in_colour(locations: Locations) -> None:
    apple, bowl = (load_config(ObjectConfig, "objects", name, locations).mesh for name in ("013_apple", "024_bowl"))
    assert np.abs(np.subtract(apple.rgba, bowl.rgba)).max() > 0.3
