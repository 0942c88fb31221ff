"""Compare the frames of two episodes: find the first difference, and the largest difference of each value."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass(frozen=True)
class ValueDifference:
    """A difference between a stored and a reproduced value.

    Attributes:
        frame: None for a value of the whole episode.
        time_s: simulated time of the frame, s.
        quantity: such as `joints[2]` or `banana_pose[0, 3]`.
        stored, got: numbers in the unit of the quantity, else text.
        difference: absolute up to a stored value of 1, relative above; None unless both are finite and of equal shape.
    """

    frame: int | None
    time_s: float | None
    quantity: str
    stored: float | str
    got: float | str
    difference: float | None


@dataclass
class EpisodeComparison:
    """Result of comparing two episodes.

    Attributes:
        largest: quantity -> largest difference: absolute up to a stored value of 1 (rad, m), relative above, such as
            for a focal length in px.
        first_difference: first difference beyond the tolerance. If a frame has several, the largest one.
    """

    largest: dict[str, float] = field(default_factory=dict)
    first_difference: ValueDifference | None = None

    @property
    def max_error(self) -> float:
        """The largest difference of all quantities."""
        return max(self.largest.values(), default=0.0)


def compare_frames(
    stored: Sequence[Mapping[str, Any]], made: Sequence[Mapping[str, Any]], tolerance: float
) -> EpisodeComparison:
    """Compare the data of two episodes, except images. `tolerance` is as in `EpisodeComparison.largest`."""
    result = EpisodeComparison()
    for k, (old, new) in enumerate(zip(stored, made, strict=False)):
        time = old.get("timestamp")
        _compare_mappings(result, old, new, tolerance, k, time if isinstance(time, float) else None)
    if len(stored) != len(made) and result.first_difference is None:
        result.first_difference = ValueDifference(None, None, "frames", float(len(stored)), float(len(made)), None)
    return result


def compare_values(stored: Mapping[str, Any], made: Mapping[str, Any], tolerance: float) -> EpisodeComparison:
    """Compare values of whole episodes, such as outcomes; `tolerance` is for numbers."""
    result = EpisodeComparison()
    _compare_mappings(result, stored, made, tolerance, None, None)
    return result


def _compare_mappings(
    result: EpisodeComparison,
    stored: Mapping[str, Any],
    made: Mapping[str, Any],
    tolerance: float,
    frame: int | None,
    time: float | None,
) -> None:
    worst: ValueDifference | None = None
    for quantity, old, new in _paired_values(stored, made):
        index, apart = _largest_difference(old, new)
        if apart is not None and _is_number(old):
            result.largest[quantity] = max(result.largest.get(quantity, 0.0), apart)
        if apart is not None and apart <= tolerance:
            continue
        size = math.inf if apart is None else apart
        if worst is None or size > (math.inf if worst.difference is None else worst.difference):
            place = f"[{', '.join(map(str, index))}]" if index else ""
            worst = ValueDifference(
                frame, time, quantity + place, _displayed_value(old, index), _displayed_value(new, index), apart
            )
    result.first_difference = result.first_difference or worst


def _paired_values(
    stored: Mapping[str, Any], made: Mapping[str, Any], prefix: str = ""
) -> Iterator[tuple[str, Any, Any]]:
    """Yield name, stored and reproduced value of every entry; `_MISSING_VALUE` replaces an absent value."""
    for key in dict.fromkeys([*stored, *made]):
        name = f"{prefix}.{key}" if prefix else str(key)
        old, new = stored.get(key, _MISSING_VALUE), made.get(key, _MISSING_VALUE)
        if isinstance(old, Mapping) and isinstance(new, Mapping):
            yield from _paired_values(old, new, name)
        else:
            yield name, old, new


_MISSING_VALUE = "missing"


def _is_number(value: Any) -> bool:
    return isinstance(value, float | int | np.ndarray) and not isinstance(value, bool)


def _largest_difference(old: Any, new: Any) -> tuple[tuple[int, ...], float | None]:
    """Return index and size of the largest difference; size None without numbers."""
    if not (_is_number(old) and _is_number(new)):
        same = type(old) is type(new) and bool(old == new)
        return (), 0.0 if same else None
    a, b = np.asarray(old), np.asarray(new)
    if a.shape != b.shape or a.dtype != b.dtype:
        return (), None
    if not a.size:
        return (), 0.0
    with np.errstate(invalid="ignore"):
        gap = np.abs(b.astype(float) - a.astype(float)) / np.maximum(1.0, np.abs(a.astype(float)))
    bad = ~np.isfinite(gap)
    index = tuple(int(k) for k in np.unravel_index(int(np.argmax(bad) if bad.any() else np.argmax(gap)), a.shape))
    return index, None if bad.any() else float(gap[index])


def _displayed_value(value: Any, index: tuple[int, ...]) -> float | str:
    if isinstance(value, np.ndarray):
        if not index and value.ndim:
            return f"{value.dtype} {value.shape}"
        value = value[index].item()
    if isinstance(value, float | int) and not isinstance(value, bool) and math.isfinite(value):
        return float(value)
    return str(value)
