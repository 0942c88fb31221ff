"""The episode of an attempt."""

from __future__ import annotations

from ..episode.episode import Episode, EpisodeGoal, OnStep
from ..episode.rules import EpisodeRules
from ..types import Attempt
from .expert import sides
from .simulator import Simulator


def open_episode(simulator: Simulator, attempt: Attempt, rules: EpisodeRules, on_step: OnStep | None = None) -> Episode:
    """Return the episode of an attempt at its start, in the attempt's varied scene.

    Args:
        on_step: see `Episode`.
    """
    assert attempt.start is not None, "an attempt without a layout has no episode"
    task = simulator.config.task
    goal = EpisodeGoal(task.goal, simulator.cast, task.hold_ticks)
    scene = simulator.varied(attempt)
    return Episode(scene, attempt.start, task.timing, sides(simulator.config), goal, rules, on_step=on_step)
