"""Chooses some of a dataset's episodes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from ..errors import DatasetError, UsageError, ranges
from .layout import episode_directories

_RANGE = re.compile(r"^(?:ep_)?(\d+)(?:-(?:ep_)?(\d+))?$")


def select_episodes(dataset: Path, episodes: str | None, sample: int | None) -> list[tuple[int, Path]]:
    """Number and directory of the chosen episodes, in order.

    Args:
        episodes: numbers and ranges, such as `0,3,5-9`; None for all.
        sample: how many to take, spread evenly over the dataset.

    Raises:
        DatasetError: there is no dataset.
        UsageError: an episode is not there, or `episodes` is not a list of numbers and ranges.
    """
    if not dataset.is_dir():
        raise DatasetError(f"{dataset} is not a directory; give the directory that `yamsim record` wrote")
    there = dict(episode_directories(dataset))
    if not there:
        raise DatasetError(f"{dataset} holds no episodes (ep_NNNNNN); give the directory that `yamsim record` wrote")
    numbers = sorted(there)
    if episodes is not None:
        numbers = _parse(episodes, dataset, numbers)
    elif sample is not None and sample < len(numbers):
        step = (len(numbers) - 1) / max(1, sample - 1)
        numbers = [numbers[round(k * step)] for k in range(sample)]
    return [(number, there[number]) for number in numbers]


def _parse(text: str, dataset: Path, there: Sequence[int]) -> list[int]:
    chosen: set[int] = set()
    for part in text.split(","):
        match = _RANGE.match(part.strip())
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
        if first > last:
            raise UsageError(
                f"--episodes {text!r}: {part.strip()!r} is neither a number nor a range; valid: {ranges(there)}"
            )
        # Compared with what is there: a list of the whole range might not fit into memory.
        named = [number for number in there if first <= number <= last]
        if len(named) != last - first + 1:
            missing = next(number for number in range(first, last + 1) if number not in set(named))
            raise UsageError(f"--episodes {text!r}: {dataset} has no episode {missing}; valid: {ranges(there)}")
        chosen.update(named)
    return sorted(chosen)
