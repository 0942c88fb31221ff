"""Whether a task has a start at all: its first attempts, sampled."""

from __future__ import annotations

from ..documents.base import ConflictError
from ..goals.world import TABLE
from ..session import Session
from ..types import EpisodeJob
from .sampling import HOLDS_ALREADY, no_start, sample
from .simulators import Simulators

# So many attempts without a start are taken for a task that has none; mostly, the first one has one.
_FIRST = 3


def check_starts(session: Session) -> None:
    """Make sure that one of the first attempts of a task has a start.

    Raises:
        ConflictError: none has: its goal holds already, or its things have no room; the path is where, from the config.
        SimulationError: its scene cannot be compiled.
    """
    task = session.config.task
    with Simulators(session.without_meshes()) as simulators:
        for number in range(_FIRST):
            job = EpisodeJob(session.config.seed, number)
            simulator = simulators.of(job)
            attempt = sample(simulator, job)
            if attempt.layout is not None:
                return
            why = no_start(simulator, attempt)
    told = f"{why}; none of the first {_FIRST} attempts of seed {session.config.seed} has a start"
    if why.startswith(HOLDS_ALREADY):
        raise ConflictError(told, ("task", "goal"))
    role = next(role for role in reversed(list(task.starts)) if task.starts[role].on == TABLE)
    raise ConflictError(told, ("task", "starts", role))
