from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.geometry.se3 import Array
from ..core.images.image import Image

# Source: lerobot 0.4.4 and 0.6.1, `compute_stats.DEFAULT_QUANTILES`.
_QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
_INTENSITY_LEVELS = 256  # intensity levels of an 8-bit channel
_PIXEL_STRIDE = 4  # pixels between counted rows and columns; means and quantiles hardly change

Stats = dict[str, Array]


def column_stats(values: ArrayLike) -> Stats:
    """Return statistics of values (frames, ...) over the frames. `count` (1,) is the number of frames."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == 1:
        array = array[:, None]
    stats = {"min": array.min(0), "max": array.max(0), "mean": array.mean(0), "std": array.std(0)}
    stats |= dict(zip(_QUANTILES, np.quantile(array, list(_QUANTILES.values()), axis=0), strict=True))
    return stats | {"count": np.array([float(len(array))])}


class PixelCounts:
    """Histogram of each image channel's intensity levels, from which all statistics follow exactly."""

    def __init__(self) -> None:
        self._counts = np.zeros((3, _INTENSITY_LEVELS), np.int64)
        self._images = 0

    def add(self, image: Image) -> None:
        """Add an RGB image (height, width, 3)."""
        pixels = image[::_PIXEL_STRIDE, ::_PIXEL_STRIDE]
        for channel in range(3):
            self._counts[channel] += np.bincount(pixels[..., channel].ravel(), minlength=_INTENSITY_LEVELS)
        self._images += 1

    def stats(self) -> Stats:
        """Return statistics of the channels scaled to 0..1, each (3, 1, 1). `count` (1,) is the number of images."""
        total = self._counts.sum(1)
        levels = np.arange(_INTENSITY_LEVELS) / (_INTENSITY_LEVELS - 1)
        mean = self._counts @ levels / total
        spread = np.sqrt(np.maximum(self._counts @ levels**2 / total - mean**2, 0.0))
        stats = {"min": self._quantile_level(0.0), "max": self._quantile_level(1.0), "mean": mean, "std": spread}
        stats |= {name: self._quantile_level(part) for name, part in _QUANTILES.items()}
        return {name: value.reshape(3, 1, 1) for name, value in stats.items()} | {
            "count": np.array([float(self._images)])
        }

    def _quantile_level(self, part: float) -> Array:
        """Return the intensity (3,), 0..1, at or below which the share `part` of the pixels of each channel lies."""
        below = np.cumsum(self._counts, axis=1)
        enough = np.maximum(1, np.ceil(part * below[:, -1:]))
        found: NDArray[np.intp] = (below >= enough).argmax(axis=1)
        return found / (_INTENSITY_LEVELS - 1)


class RunningStats:
    """Merges the statistics of many episodes: exactly, except that quantiles are means weighted by `count`.

    Source: `aggregate_feature_stats` of lerobot 0.4.4 and 0.6.1, which gives the same numbers.
    """

    def __init__(self) -> None:
        self._features: dict[str, Stats] = {}

    def add(self, episode: Mapping[str, Stats]) -> None:
        """Add the statistics of an episode, by feature."""
        for key, stats in episode.items():
            self._features[key] = _combine(self._features[key], stats) if key in self._features else dict(stats)

    def stats(self) -> dict[str, Stats]:
        """Return feature -> statistics of all episodes."""
        return self._features


def _combine(one: Stats, other: Stats) -> Stats:
    counts = one["count"], other["count"]
    total = counts[0] + counts[1]
    share = float(counts[1][0] / total[0])
    mean = one["mean"] + (other["mean"] - one["mean"]) * share
    apart = other["mean"] - one["mean"]
    variance = one["std"] ** 2 * (1 - share) + other["std"] ** 2 * share + apart**2 * share * (1 - share)
    result = {name: one[name] + (other[name] - one[name]) * share for name in _QUANTILES}
    return result | {
        "min": np.minimum(one["min"], other["min"]),
        "max": np.maximum(one["max"], other["max"]),
        "mean": mean,
        "std": np.sqrt(variance),
        "count": total,
    }
