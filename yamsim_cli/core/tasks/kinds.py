"""The kinds of task there are: a task's config names one, and the kind says what its demonstrations are made of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..config.record import GraspKind
from ..config.scene import GraspPoint, Table
from ..config.task import TaskConfig
from ..errors import ConfigError, suggest
from ..geometry.se3 import Array
from ..types import Layout, Motion, Outcome, Phases, Plan
from . import pickplace, plans


class Judge(Protocol):
    """Tells how an attempt ended, see `pickplace.judge`."""

    def __call__(
        self,
        task: TaskConfig,
        grasp: GraspKind,
        poses: pickplace.Poses,
        speed: float,
        motion: Motion,
        plan_error: float,
        tilt: float,
        *,
        planned: bool = True,
    ) -> Outcome:
        """Judge an attempt."""
        ...


@dataclass(frozen=True)
class TaskKind:
    """What demonstrations of one kind of task are made of; all are functions of numbers alone.

    Attributes:
        sample_layout: draws where things start; None where there is no room.
        grasp_points: where the object may be held, the best place first.
        make_plan: what the hand does, once it is decided how the object is held.
        phases: when the object is in hand; it depends on nothing that is random.
        ticks: how many control ticks an attempt has.
        judge: tells how an attempt ended.
    """

    sample_layout: Callable[[TaskConfig, Table, np.random.Generator], Layout | None]
    grasp_points: Callable[[TaskConfig, GraspKind], tuple[GraspPoint, ...]]
    make_plan: Callable[[TaskConfig, GraspKind, Layout, Array, plans.Hold], Plan]
    phases: Callable[[TaskConfig, GraspKind], Phases]
    ticks: Callable[[TaskConfig, GraspKind], int]
    judge: Judge


# A new kind is a file in this folder, a line here, and a YAML in configs/tasks/.
KINDS: Mapping[str, TaskKind] = {
    "pickplace": TaskKind(
        pickplace.sample_layout, plans.grasp_points, plans.make_plan, plans.phases, plans.ticks, pickplace.judge
    ),
}


def kind_of(task: TaskConfig) -> TaskKind:
    """The kind that a task names.

    Raises:
        ConfigError: there is none of that name.
    """
    if task.kind not in KINDS:
        raise ConfigError(f"task {task.name!r}: unknown kind {task.kind!r}; {suggest(task.kind, KINDS)}")
    return KINDS[task.kind]
