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
    rows = []
    for top in range(0, grey.shape[0] - PATCH + 1, PATCH):
        for left in range(0, grey.shape[1] - PATCH + 1, PATCH):
            place = np.s_[top : top + PATCH, left : left + PATCH]
            if region[place].mean() < _SHARE:
                continue
            colours = lab[place].reshape(-1, 3)
            low, high = np.quantile(colours[:, 0], (0.05, 0.95))
            spread = np.log(colours.std(axis=0) + 0.1)
            edges = np.log([gradient[place].mean() + 0.1, gradient[place].std() + 0.1, detail[place].std() + 0.1])
            middle = np.log(np.median(np.abs(detail[place])) + 0.1)
            rows.append([*colours.mean(axis=0), *spread, *edges, middle, low, high, np.hypot(*colours[:, 1:].mean(0))])
    return np.array(rows).reshape(-1, 13)


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
