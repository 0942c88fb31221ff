"""Times of samples as others keep them, and what is wrong with them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..errors import DatasetError
from ..geometry.se3 import Array


def from_nanoseconds(stamps: ArrayLike, source: str) -> Array:
    """Seconds (n,) since the first of time stamps in ns.

    Raises:
        DatasetError: see `from_seconds`.
    """
    values = np.asarray(stamps)
    if values.ndim != 1 or values.dtype.kind not in "iu":
        raise DatasetError(f"{source}: timestamps are {values.dtype} {values.shape}; valid: whole numbers (n,), ns")
    if len(values) < 2:
        raise DatasetError(f"{source}: has {len(values)} samples; a motion needs two at least")
    # Differences first: 19 digits do not fit into a float.
    return from_seconds((values - values[0]).astype(np.float64) * 1e-9, source)


def from_seconds(times: Array, source: str) -> Array:
    """Times (n,) since the first of them, s.

    Raises:
        DatasetError: there are fewer than two, or they do not increase.
    """
    if len(times) < 2:
        raise DatasetError(f"{source}: has {len(times)} samples; a motion needs two at least")
    back = np.flatnonzero(~(np.diff(times) > 0))
    if len(back):
        k = int(back[0])
        raise DatasetError(
            f"{source}: sample {k + 1} is at {times[k + 1]:.4f} s, and the one before at {times[k]:.4f} s: times "
            "increase; take out what is there twice"
        )
    since: Array = times - times[0]
    return since
