"""Named random streams, one for each sampled quantity, so that a new quantity does not change the other samples."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from ..attempt_data import AttemptJob


class Stream(IntEnum):
    """What a random stream samples. The values are part of the seeds: add new ones, but never renumber."""

    LAYOUT = 0
    LIGHTS = 10
    HEADLIGHT = 11
    MASS = 12
    FRICTION = 13
    LENS = 14
    CAMERA = 15
    TABLE = 16
    FLOOR = 17
    APPEARANCE = 18
    DISTRACTORS = 19
    TONE = 20
    NOISE = 21
    SALT_PEPPER = 22
    READINGS = 23
    ARMS = 24
    SENSOR = 25
    WALLS = 26
    ROLES = 30
    PHRASING = 31
    PLACES = 32
    PLANNING = 33
    CRUMPLES = 34
    DISTURBANCES = 35


def random_generator(job: AttemptJob, stream: Stream, *of: int) -> np.random.Generator:
    """Return the generator of a stream of an attempt, independent of all other attempts and streams.

    `of` splits the stream further, for example by the indices of a frame and a camera.
    """
    # NumPy ignores trailing zeros of a seed, so all indices are increased by one.
    return np.random.default_rng([job.seed, job.attempt, int(stream), *(number + 1 for number in of)])
