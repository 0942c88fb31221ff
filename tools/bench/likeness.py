"""How well a small classifier tells photos from renderings: logistic regression on colours and detail of patches.

No network is involved: none of the packages that this project installs ships weights of one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.images.image import Image

PATCH = 16  # px, side
COARSE = 2.0  # px, sigma of a blur that leaves no noise and no JPEG artefacts to tell by
_SHARE = 0.6  # of a patch that has to be in the region
_FOLDS = 5  # of stations, each tested by a classifier that was trained on the others
_PENALTY = 1.0  # of the squared weights, in units of one patch
_NEWTON_STEPS = 25


@dataclass(frozen=True)
class ViewOfStation:
    """Images (height, width, 3) of one state: the photo, and renderings of it by name; the arms (height, width)."""

    photo: Image
    renderings: dict[str, Image]
    arms: NDArray[np.bool_]


def accuracy(views: Sequence[ViewOfStation], rendering: str, *, arms_only: bool, blur: float = 0.0) -> float:
    """Return the share of held-out patches that are classified correctly: 0.5 if nothing tells them apart.

    Photos and renderings have equally many patches, at the same places. No station is in training and test at once.
    """
    stations = []
    for view in views:
        region = view.arms if arms_only else np.ones_like(view.arms)
        pair = [_features(image, region, blur) for image in (view.photo, view.renderings[rendering])]
        stations.append((np.concatenate(pair), np.repeat([1.0, 0.0], [len(part) for part in pair])))
    right = total = 0
    for fold in range(min(_FOLDS, len(stations))):
        known, held = ([one for k, one in enumerate(stations) if (k % _FOLDS == fold) == out] for out in (False, True))
        x, y = (np.concatenate(parts) for parts in zip(*known, strict=True))
        middle, scale = x.mean(axis=0), x.std(axis=0) + 1e-9
        weights = _train(_expanded((x - middle) / scale), y)
        for x_held, y_held in held:
            right += int(((_expanded((x_held - middle) / scale) @ weights > 0) == (y_held > 0.5)).sum())
            total += len(y_held)
    return right / total


def _features(image: Image, region: NDArray[np.bool_], blur: float) -> Array:
    """Return features (n, 13) of patches: mean and deviation of each colour (Lab), gradients, detail, extremes."""
    values = cv2.GaussianBlur(image, (0, 0), blur) if blur else image
    lab = cv2.cvtColor(values.astype(np.float32) / 255, cv2.COLOR_RGB2LAB)
    grey = lab[..., 0]
    gradient = np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1))
    detail = cv2.Laplacian(grey, cv2.CV_32F)
    kept = _patches(region.astype(np.float32)).mean(axis=1) >= _SHARE
    colours, slopes, details = (_patches(np.asarray(part, np.float32))[kept] for part in (lab, gradient, detail))
    means, levels = colours.mean(axis=1), colours[..., 0]
    chroma = np.hypot(means[:, 1], means[:, 2])
    spreads = [slopes.mean(axis=1), slopes.std(axis=1), details.std(axis=1), np.median(np.abs(details), axis=1)]
    logs = np.log(np.column_stack([colours.std(axis=1), *spreads]) + 0.1)
    return np.column_stack([means, logs, np.quantile(levels, 0.05, axis=1), np.quantile(levels, 0.95, axis=1), chroma])


def _patches(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the pixels of all whole patches, (n, PATCH * PATCH) or (n, PATCH * PATCH, channels)."""
    rows, columns = values.shape[0] // PATCH, values.shape[1] // PATCH
    grid = values[: rows * PATCH, : columns * PATCH].reshape(rows, PATCH, columns, PATCH, *values.shape[2:])
    return grid.swapaxes(1, 2).reshape(rows * columns, PATCH * PATCH, *values.shape[2:])


def _expanded(x: Array) -> Array:
    """Return features with their products and a constant: boundaries of second order."""
    first, second = np.triu_indices(x.shape[1])
    return np.column_stack([np.ones(len(x)), x, x[:, first] * x[:, second]])


def _train(x: Array, y: Array) -> Array:
    """Return the weights of a logistic regression with a penalty, by Newton's method."""
    weights = np.zeros(x.shape[1])
    ridge = np.full(x.shape[1], _PENALTY)
    for _ in range(_NEWTON_STEPS):
        share = 1 / (1 + np.exp(-np.clip(x @ weights, -30, 30)))
        slope = x.T @ (y - share) - ridge * weights
        curve = (x * (share * (1 - share))[:, None]).T @ x + np.diag(ridge)
        step = np.linalg.solve(curve, slope)
        weights += step
        if np.abs(step).max() < 1e-4:
            break
    return weights
