"""When each row of an image is exposed, and how rendered states combine to the image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .config import CameraEffects


def sample_times(effects: CameraEffects) -> NDArray[np.float64]:
    """Return the times (n,) of the rendered states, s relative to the frame's, in ascending order up to 0."""
    span = (effects.exposure_ms + effects.readout_ms) / 1000
    return np.linspace(-span, 0.0, effects.shutter_samples)


def row_weights(effects: CameraEffects, rows: int) -> NDArray[np.float32]:
    """Return the weight (n, rows) of each rendered state in each row; the weights of a row sum to 1.

    Row r is exposed for `exposure_ms` until its time, which is 0 for the last row and `-readout_ms` for the first. Its
    value is the mean over this time of the value between the states, which is interpolated linearly.
    """
    times = sample_times(effects)
    end = effects.readout_ms / 1000 * (np.arange(rows) / max(1, rows - 1) - 1.0)
    start = end - effects.exposure_ms / 1000
    if effects.exposure_ms == 0:
        return np.stack([_tent(times, k, end) for k in range(len(times))]).astype(np.float32)
    integrals = np.stack([_tent_integral(times, k, end) - _tent_integral(times, k, start) for k in range(len(times))])
    return (integrals / (end - start)).astype(np.float32)


def _tent(times: NDArray[np.float64], k: int, at: NDArray[np.float64]) -> NDArray[np.float64]:
    weight: NDArray[np.float64] = np.interp(at, times, np.eye(len(times))[k])
    return weight


def _tent_integral(times: NDArray[np.float64], k: int, until: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the integral of state k's linear interpolation weight from the first time on; times are even."""
    step = times[1] - times[0]
    x = np.clip((until - times[k]) / step, -1.0, 1.0)
    rising, falling = (np.minimum(x, 0.0) + 1.0) ** 2 / 2, np.maximum(x, 0.0) - np.maximum(x, 0.0) ** 2 / 2
    total: NDArray[np.float64] = step * (rising + falling - (0.5 if k == 0 else 0.0))
    return total


def combine(images: NDArray[np.uint8], weights: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return the image (rows, columns, 3) of rendered states (n, rows, columns, 3) with `row_weights`."""
    total = np.zeros(images.shape[1:], np.float32)
    for image, weight in zip(images, weights, strict=True):
        total += weight[:, None, None] * image
    return np.rint(total).astype(np.uint8)
