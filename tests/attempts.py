"""Attempts for tests: demonstrated from their numbers, and their actions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from yamsim_cli.core.attempt_data import ActionSequence, AttemptJob, StepState
from yamsim_cli.core.episode.execution import SimulatedAttempt, simulate_expert
from yamsim_cli.core.episode.sampling import sample_attempt
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.geometry.se3 import Array


def planned(simulator: Simulator, seed: int, attempt: int = 0) -> SimulatedAttempt:
    """Return the expert's attempt."""
    return simulate_expert(simulator, sample_attempt(simulator, AttemptJob(seed, attempt)))


def start_of(simulator: Simulator, seed: int = 0) -> Array:
    """MuJoCo's positions (nq,) at the start of a seed's first attempt."""
    start = sample_attempt(simulator, AttemptJob(seed, 0)).start
    assert start is not None
    return start


def all_actions(states: Sequence[StepState]) -> ActionSequence:
    """Join the actions of all frames."""
    parts = [state.actions for state in states]
    return ActionSequence(
        *(np.concatenate([getattr(part, key) for part in parts]) for key in ("ctrl", "magnet", "joints"))
    )
