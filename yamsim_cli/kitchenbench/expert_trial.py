"""`run_expert`: let the expert act in its planning scene, judged after every motion."""

from __future__ import annotations

from collections.abc import Callable

from .policy import PlanningScene
from .success_judges import Judge


def run_expert(
    planning: PlanningScene, judge: Judge, max_actions: int, after_motion: Callable[[], None] | None = None
) -> int:
    """Let the expert act until the judge reports success, and return the number of actions.

    No motion begins after `max_actions`, but the last one may exceed them. `after_motion` is called after each motion.
    """
    actions = 0
    while actions < max_actions and not judge.evaluate()[0]:
        actions += len(planning.next_actions())
        if after_motion is not None:
            after_motion()
    return actions
