"""All that was found in a dataset: its episodes, its attempts, and its faults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from .checks.context import Context
from .checks.facts import EpisodeFacts
from .checks.ledger import read_ledger
from .checks.problem import Problem, Problems
from .checks.whole import check_whole
from .records import AttemptRecord


@dataclass(frozen=True)
class Survey:
    """All that was found in a dataset.

    Attributes:
        path: the dataset's directory.
        context: what its config says.
        episodes: its episodes, in order.
        attempts: the attempts in the ledger that can be read.
        problems: faults of the dataset first, then those of its episodes in order.
    """

    path: Path
    context: Context
    episodes: Sequence[EpisodeFacts]
    attempts: Sequence[AttemptRecord]
    problems: Sequence[Problem]


def survey(dataset: Path, context: Context, episodes: Sequence[EpisodeFacts], problems: Problems) -> Survey:
    """The survey of a dataset, from what was found in each episode, with the checks that concern all of them.

    Args:
        episodes: what was found in each, in order.
        problems: faults that were found before the episodes were looked at.
    """
    attempts = read_ledger(dataset, problems) if context.recorded else []
    found = check_whole(dataset, context, episodes, attempts, problems)
    found += [problem for episode in episodes for problem in episode.problems]
    found.sort(key=lambda problem: problem.episode)
    return Survey(dataset, context, episodes, attempts, [*problems.list(), *found])
