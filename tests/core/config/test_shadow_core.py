"""The banana's shadow, which its scan does not cast itself: where light grazes the scan, that would speckle it."""

from __future__ import annotations

import numpy as np

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.things.primitives import Capsule
from yamsim_cli.core.config.things.thing import ObjectConfig
from yamsim_cli.core.resources import Locations


def _depth(point: np.ndarray, within: Capsule) -> float:
    """How deep a point (3,) lies in a capsule, m."""
    start, end = np.array(within.start), np.array(within.end)
    share = np.clip((point - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
    return within.radius - float(np.linalg.norm(point - start - share * (end - start)))


def test_the_bananas_core_casts_its_shadow_and_is_not_seen(locations: Locations) -> None:
    item = load_config(ObjectConfig, "objects", "011_banana", locations)
    assert not item.mesh.castshadow
    core = [part for part in item.look if isinstance(part, Capsule) and part.rgba is None]
    assert core
    touching = [part for part in item.collision if isinstance(part, Capsule)]
    straight = core[0]  # along the part that one collision capsule covers
    for end in (straight.start, straight.end):
        assert max(_depth(np.array(end), part) for part in touching) - straight.radius >= 0.003
