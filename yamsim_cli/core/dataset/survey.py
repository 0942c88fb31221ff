"""All that was found in a dataset: its episodes, its attempts, and what is wrong."""

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
    """A dataset, looked through.

    Attributes:
        path: of the dataset.
        context: what its config says.
        episodes: in order.
        attempts: those in the ledger that can be read.
        problems: of the dataset first, then of its episodes in order.
    """

    path: Path
    context: Context
    episodes: Sequence[EpisodeFacts]
    attempts: Sequence[AttemptRecord]
    problems: Sequence[Problem]


def survey(dataset: Path, context: Context, episodes: Sequence[EpisodeFacts], problems: Problems) -> Survey:
    """Put together what was found in the episodes, and check what concerns all of them.

    Args:
        episodes: in order.
        problems: what was found before the episodes were looked at.
    """
    attempts = read_ledger(dataset, problems) if context.recorded else []
    found = check_whole(dataset, context.recorded, episodes, attempts, problems)
    found += [problem for episode in episodes for problem in episode.problems]
    found.sort(key=lambda problem: problem.episode)
    return Survey(dataset, context, episodes, attempts, [*problems.list(), *found])
