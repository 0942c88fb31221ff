"""Shuffled batches whose order depends only on the seed and the epoch."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from yamsim_cli.core.errors import UsageError


class ShuffledBatches:
    """Batches of indices 0 .. `count` - 1, each once in an epoch, as a sampler for `torch.utils.data.DataLoader`.

    The order does not depend on the number of workers. Each batch of `ranks` processes together is cut from one order,
    so two ranks with batches of 32 train on the same 64 windows as one rank with batches of 64. The windows that are
    left over at the end of an epoch are omitted. They differ in each epoch.

    Args:
        count: number of windows.
        size: windows of a batch of one rank.
        rank: number of this process, from 0.
        ranks: number of processes that train together.
    """

    def __init__(self, count: int, size: int, *, seed: int = 0, rank: int = 0, ranks: int = 1) -> None:
        if not 0 <= rank < ranks:
            raise UsageError(f"rank={rank} is not valid: with ranks={ranks}, give 0 to {ranks - 1}")
        if not 1 <= size * ranks <= count:
            raise UsageError(
                f"size={size} is not valid: {ranks} ranks need {size * ranks} windows for a batch, and there are "
                f"{count}; give 1 to {count // ranks}"
            )
        self._count, self._size, self._seed, self._rank, self._ranks = count, size, seed, rank, ranks
        self._epoch = 0

    def set_epoch(self, epoch: int) -> None:
        """Choose the order of an epoch, on all ranks alike. Without it, every epoch has the order of epoch 0."""
        self._epoch = epoch

    def __len__(self) -> int:
        return self._count // (self._size * self._ranks)

    def __iter__(self) -> Iterator[list[int]]:
        order = np.random.default_rng([self._seed, self._epoch]).permutation(self._count)
        for number in range(len(self)):
            first = (number * self._ranks + self._rank) * self._size
            yield order[first : first + self._size].tolist()
