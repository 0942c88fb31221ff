"""Give an attempt its distractors: where they stand depends on what moves in it, so that they come after physics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..types import Attempt, StepState
from .simulator import Simulator


def with_distractors(simulator: Simulator, attempt: Attempt, states: Sequence[StepState]) -> Attempt:
    """The same attempt with distractors where nothing comes near them; as it is where the config has none.

    Args:
        states: throughout the attempt.
    """
    if simulator.placer is None:
        return attempt
    places = simulator.placer.places(attempt.job, [state.qpos for state in states])
    return replace(attempt, variation=replace(attempt.variation, distractors=places))
