"""Weights of rendered states against numerical integration, and the skew of a moving edge."""

from __future__ import annotations

import numpy as np
import pytest

from yamsim_cli.camera_effects.config import CameraEffects
from yamsim_cli.camera_effects.shutter import combine, row_weights, sample_times

ROWS = 24


@pytest.mark.parametrize(("exposure", "readout"), [(10.0, 0.0), (0.0, 20.0), (8.0, 18.4), (30.0, 5.0)])
def test_weights_are_the_mean_over_each_rows_exposure(exposure: float, readout: float) -> None:
    effects = CameraEffects(exposure_ms=exposure, readout_ms=readout, shutter_samples=5)
    times, weights = sample_times(effects), row_weights(effects, ROWS)
    assert times[-1] == 0.0 and times[0] == pytest.approx(-(exposure + readout) / 1000)
    np.testing.assert_allclose(weights.sum(axis=0), 1.0, atol=1e-6)
    for row in range(ROWS):
        end = readout / 1000 * (row / (ROWS - 1) - 1)
        moments = np.linspace(end - exposure / 1000, end, 4001)
        wanted = [np.interp(moments, times, np.eye(5)[k]).mean() for k in range(5)]
        np.testing.assert_allclose(weights[:, row], wanted, atol=1e-3)


def test_a_rolling_shutter_skews_a_moving_edge() -> None:
    """An edge at 1000 px/s moves 20 px between the first and the last row of 20 ms."""
    effects = CameraEffects(readout_ms=20.0, shutter_samples=21)
    columns = np.arange(64)
    images = [np.where(columns < 40 + 1000 * time, 255, 0) for time in sample_times(effects)]
    stack = np.stack([np.broadcast_to(line[None, :, None], (ROWS, 64, 3)) for line in images]).astype(np.uint8)
    picture = combine(stack, row_weights(effects, ROWS))
    edge = (picture[:, :, 0] / 255.0).sum(axis=1)
    np.testing.assert_allclose(edge, 40 - 20 * (1 - np.arange(ROWS) / (ROWS - 1)), atol=1.0)


def test_motion_blur_smears_a_moving_edge() -> None:
    effects = CameraEffects(exposure_ms=16.0, shutter_samples=17)
    columns = np.arange(64)
    images = [np.where(columns < 40 + 1000 * time, 255, 0) for time in sample_times(effects)]
    stack = np.stack([np.broadcast_to(line[None, :, None], (ROWS, 64, 3)) for line in images]).astype(np.uint8)
    line = combine(stack, row_weights(effects, ROWS))[0, :, 0] / 255.0
    np.testing.assert_allclose(line, np.clip((39.5 - columns) / 16, 0, 1), atol=1 / 16)
