"""The kinds of task. A task's config names one, and the kind has the functions that make its demonstrations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ..config.recording import GraspKind, RecordConfig
from ..config.task import TaskConfig
from ..config.things.thing import GraspPoint
from ..errors import ConfigError, suggest
from ..geometry.se3 import Array
from ..types import EpisodeJob, Layout, Motion, Outcome, Phases, Plan
from . import handover, pickplace, plans
from .randomness import Stream, generator


class Judge(Protocol):
    """A function that says how an attempt ended, see `pickplace.judge`."""

    def __call__(
        self,
        task: TaskConfig,
        grasp: GraspKind,
        poses: pickplace.Poses,
        speed: float,
        motion: Motion,
        *,
        planned: bool,
    ) -> Outcome:
        """How an attempt ended."""
        ...


@dataclass(frozen=True)
class OneArmed:
    """The parts of a task that one arm does and `core.planning.choice` plans; functions of numbers alone.

    Attributes:
        grasp_points: gives the places where the object may be held as it stands, the best one first for an arm whose
            base is at a pose (4, 4).
        make_plan: gives what the hand does, once it is decided how it holds the object.
    """

    grasp_points: Callable[[TaskConfig, GraspKind, Layout, Array], tuple[GraspPoint, ...]]
    make_plan: Callable[[TaskConfig, GraspKind, Layout, Array, plans.Hold], Plan]


@dataclass(frozen=True)
class TaskKind:
    """The parts of one kind of task; functions of numbers alone.

    Attributes:
        sample_layout: where things start, sampled; None where there is no room.
        phases: when the object is in hand, and in whose; it follows from the config alone.
        ticks: how many control ticks an attempt has; likewise.
        start_opening: how far each finger of the arms that act is open at the start, m; likewise.
        judge: tells how an attempt ended.
        one_armed: of a task that one arm does; any other has its planner in `core.planning.planners`.
    """

    sample_layout: Callable[[RecordConfig, np.random.Generator], Layout | None]
    phases: Callable[[RecordConfig], tuple[Phases, ...]]
    ticks: Callable[[RecordConfig], int]
    start_opening: Callable[[RecordConfig], float]
    judge: Judge
    one_armed: OneArmed | None = None


def _one_arm_phases(config: RecordConfig) -> tuple[Phases, ...]:
    return (replace(plans.phases(config.pair, config.grasp), arm=config.acting_scene_arms[0]),)


# A new kind is a file in this folder, a line here, and a YAML in configs/tasks/.
KINDS: Mapping[str, TaskKind] = {
    "pickplace": TaskKind(
        sample_layout=pickplace.sample_layout,
        phases=_one_arm_phases,
        ticks=lambda config: plans.ticks(config.pair, config.grasp),
        start_opening=lambda config: plans.start_opening(config.pair, config.grasp),
        judge=pickplace.judge,
        one_armed=OneArmed(plans.points_for, plans.make_plan),
    ),
    "handover": TaskKind(
        sample_layout=pickplace.sample_layout,
        phases=lambda config: handover.phases(config.pair, config.grasp, *config.acting_scene_arms),
        ticks=lambda config: handover.schedule(config.pair, config.grasp).total,
        start_opening=lambda config: handover.start_opening(config.pair),
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


def sample_layout(config: RecordConfig, job: EpisodeJob) -> Layout | None:
    """Where things start in an attempt; None where there is no room for them."""
    return kind_of(config.pair).sample_layout(config, generator(job, Stream.LAYOUT))
