"""Named random streams: each purpose draws from its own, so that using one more never changes what the others draw."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from ..types import EpisodeJob


class Stream(IntEnum):
    """What a random number is for. The values are part of every dataset's meaning: never renumber, only add."""

    LAYOUT = 0


def generator(job: EpisodeJob, stream: Stream) -> np.random.Generator:
    """The generator of one stream of one attempt; independent of every other attempt and stream."""
    return np.random.default_rng([job.seed, job.attempt, int(stream)])
