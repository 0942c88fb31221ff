"""How long a program usually takes, before anything of it is planned."""

from __future__ import annotations

import math
from collections.abc import Mapping

from ..config.program_task import ProgramTask
from .base import Skill
from .cloth.fold import Fold
from .program import SKILLS, program_of

# Seconds of simulated time that a skill usually takes. Source: means of successful attempts at the shipped tasks.
# No shipped task has `push`, `turn` or `regrasp`: those are estimates, by a reach and a motion, `place` and `handover`.
SKILL_SECONDS: Mapping[str, float] = {
    "pick": 2.7,
    "place": 3.0,
    "insert": 3.0,
    "handover": 4.7,
    "put_aside": 3.0,
    "push": 5.0,
    "set_upright": 7.0,
    "turn": 3.0,
    "regrasp": 9.4,
    "operate": 5.0,
    "lift": 3.7,
    "hang": 5.0,
    "fold": 6.8,
    "flatten": 7.0,
}
_THIRDS = 1.6  # of "fold": what folding in thirds takes, which is two folds of one reach; measured


def typical_ticks(task: ProgramTask) -> int:
    """Return how many control ticks a successful attempt at a task usually takes.

    Most goals have held for their hold time when the last skill ends, so nothing is added for that.

    Raises:
        ConfigError: the task's program is not valid.
    """
    seconds = sum(_seconds(skill) for skill in program_of(task, task.typical_cast))
    return min(task.most_ticks, math.ceil(seconds / task.timing.tick))


def _seconds(skill: Skill) -> float:
    (name,) = (name for name, known in SKILLS.items() if type(skill) is known)
    return SKILL_SECONDS[name] * (_THIRDS if isinstance(skill, Fold) and skill.how == "thirds" else 1)
