"""The classifier that tells photos from renderings."""

from __future__ import annotations

import numpy as np

from tools.bench.likeness import ViewOfStation, accuracy


def _views(shift: float, detail: float) -> list[ViewOfStation]:
    """Views of random colours; renderings are brighter by `shift` and have noise of a deviation `detail`."""
    rng = np.random.default_rng(4)
    views = []
    for _ in range(6):
        pair = []
        for brighter, noise in ((0.0, 3.0), (shift, detail)):
            colours = np.repeat(np.repeat(rng.uniform(60, 160, (6, 8, 3)), 16, axis=0), 16, axis=1)
            values = colours + brighter + rng.normal(0, noise, colours.shape)
            pair.append(np.clip(values, 0, 255).astype(np.uint8))
        arms = np.zeros(pair[0].shape[:2], bool)
        arms[:32] = True
        views.append(ViewOfStation(pair[0], {"after": pair[1]}, arms))
    return views


def test_equal_distributions_are_not_told_apart() -> None:
    assert 0.4 < accuracy(_views(0, 3), "after", arms_only=False) < 0.6


def test_brightness_and_detail_are_told_apart() -> None:
    assert accuracy(_views(80, 3), "after", arms_only=True) > 0.85
    assert accuracy(_views(0, 6), "after", arms_only=False) > 0.95
