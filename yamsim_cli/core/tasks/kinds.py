"""The kinds of task there are: a task's config names one, and the kind says what its demonstrations are made of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ..config.recording import GraspKind, RecordConfig
from ..config.scene import Table
from ..config.task import Sampling, TaskConfig
from ..config.things import GraspPoint
from ..errors import ConfigError, suggest
from ..geometry.se3 import Array
from ..types import EpisodeJob, Layout, Motion, Outcome, Phases, Plan
from . import handover, pickplace, plans
from .randomness import Stream, generator


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
class OneArmed:
    """What one arm does, planned by `core.planning.choice`; both are functions of numbers alone.

    Attributes:
        grasp_points: where the object may be held, the best place first.
        make_plan: what the hand does, once it is decided how the object is held.
    """

    grasp_points: Callable[[TaskConfig, GraspKind], tuple[GraspPoint, ...]]
    make_plan: Callable[[TaskConfig, GraspKind, Layout, Array, plans.Hold], Plan]


@dataclass(frozen=True)
class TaskKind:
    """What demonstrations of one kind of task are made of; all are functions of numbers alone.

    Attributes:
        sample_layout: draws where things start, the object from the first box and the target from the second; None
            where there is no room.
        phases: when the object is in hand, and in whose; it follows from the config, whatever is drawn.
        ticks: how many control ticks an attempt has; likewise.
        judge: tells how an attempt ended.
        one_armed: of a task that one arm does; any other has its planner in `core.planning.planners`.
    """

    sample_layout: Callable[[TaskConfig, Table, np.random.Generator, Sampling, Sampling], Layout | None]
    phases: Callable[[RecordConfig], tuple[Phases, ...]]
    ticks: Callable[[RecordConfig], int]
    judge: Judge
    one_armed: OneArmed | None = None


def _one_arm_phases(config: RecordConfig) -> tuple[Phases, ...]:
    return (replace(plans.phases(config.task, config.grasp), arm=config.acting_scene_arms[0]),)


# A new kind is a file in this folder, a line here, and a YAML in configs/tasks/.
KINDS: Mapping[str, TaskKind] = {
    "pickplace": TaskKind(
        sample_layout=pickplace.sample_layout,
        phases=_one_arm_phases,
        ticks=lambda config: plans.ticks(config.task, config.grasp),
        judge=pickplace.judge,
        one_armed=OneArmed(plans.grasp_points, plans.make_plan),
    ),
    "handover": TaskKind(
        sample_layout=pickplace.sample_layout,
        phases=lambda config: handover.phases(config.task),
        ticks=lambda config: handover.schedule(config.task).total,
        judge=pickplace.judge,
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


def draw_layout(config: RecordConfig, job: EpisodeJob) -> Layout | None:
    """Where things start in an attempt; None where there is no room for them."""
    rng = generator(job, Stream.LAYOUT)
    return kind_of(config.task).sample_layout(config.task, config.table, rng, config.object_box, config.target_box)
