"""Named random streams: each purpose samples from its own, so that a new purpose does not change the others."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from ..attempt_data import AttemptJob


class Stream(IntEnum):
    """The purpose of random numbers. Datasets depend on the values: never renumber, only add."""

    LAYOUT = 0
    LIGHTS = 10
    HEADLIGHT = 11
    MASS = 12
    FRICTION = 13
    LENS = 14
    CAMERA = 15
    TABLE = 16
    FLOOR = 17
    LOOKS = 18
    DISTRACTORS = 19
    TONE = 20
    NOISE = 21
    SALT_PEPPER = 22
    READINGS = 23
    ARMS = 24
    CAST = 30
    PHRASING = 31
    PLACES = 32
    SEARCH = 33
    CRUMPLES = 34


def random_generator(job: AttemptJob, stream: Stream, *of: int) -> np.random.Generator:
    """The generator of one stream of one attempt, independent of every other attempt and stream.

    Args:
        of: numbers that split the stream further, such as those of a frame and a camera.
    """
    # NumPy ignores zeros at the end, so numbers are increased by one.
    return np.random.default_rng([job.seed, job.attempt, int(stream), *(number + 1 for number in of)])
