"""Blur and motion: what they do to a picture, and how that changes with the motion."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from yamsim_cli.core.vision.fiducials.fitting.smear import Smear


def picture() -> np.ndarray:
    rng = np.random.default_rng(0)
    return cv2.GaussianBlur(rng.uniform(0, 1, (60, 80)).astype(np.float32), (0, 0), 2.0)


@pytest.mark.parametrize("motion", [(6.0, 0.0), (0.0, -5.0), (4.0, 7.0)])
def test_motion_spreads_a_point_evenly_along_a_line(motion: tuple[float, float]) -> None:
    point = np.zeros((61, 61), np.float32)
    point[30, 30] = 1.0
    seen = Smear(0.7, motion).of(point)
    assert seen.sum() == pytest.approx(1.0, abs=1e-4)
    y, x = np.mgrid[-30:31, -30:31]
    assert (seen * x).sum() == pytest.approx(0.0, abs=1e-3)
    spread = np.array([[(seen * a * b).sum() for a in (x, y)] for b in (x, y)])
    expected = 0.7**2 * np.eye(2) + np.outer(motion, motion) / 12
    assert np.diag(spread) == pytest.approx(np.diag(expected), abs=0.25)
    assert spread[0, 1] == pytest.approx(expected[0, 1], abs=0.1)


def test_derivatives_by_the_motion_are_those_of_small_steps() -> None:
    sharp, motion, step = picture(), np.array([5.0, -3.0]), 0.05
    slopes = Smear(1.0, (5.0, -3.0)).by_motion(sharp)
    for k in (0, 1):
        by = step * np.eye(2)[k]
        ahead, back = (Smear(1.0, tuple((motion + sign * by).tolist())).of(sharp) for sign in (1, -1))
        numeric = (ahead - back) / (2 * step)
        inner = np.s_[10:-10, 10:-10]
        assert np.corrcoef(numeric[inner].ravel(), slopes[k][inner].ravel())[0, 1] > 0.97
