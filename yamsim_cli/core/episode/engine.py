"""Execution of attempts: by a task's expert, or by given actions."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..expert.planning.arm_tools import start_stands
from ..expert.skills.bench import Bench, Segment, SkillFailedError
from ..expert.skills.moves import park_free
from ..expert.skills.program import RecoveryLog, program_of, run_program
from ..scene.compiled import CompiledScene
from ..scene.randomness import Stream, generator
from ..types import Actions, Attempt, Cause, Outcome, Recovery, StepState
from .commands import path_actions
from .episode import Episode, OnStep, Played
from .rules import EXPERT_RULES, EndReason, EpisodeRules
from .sampling import no_start
from .simulator import Simulator, open_episode


@dataclass(frozen=True)
class Simulated:
    """An attempt and its result.

    Attributes:
        attempt: as sampled, with the distractors that were placed later.
        outcome: how it ended.
        played: what happened; None if nothing moved.
    """

    attempt: Attempt
    outcome: Outcome
    played: Played | None

    @property
    def states(self) -> tuple[StepState, ...]:
        """The state of every recorded frame; none if nothing moved."""
        return self.played.states if self.played else ()


def demonstrate(simulator: Simulator, attempt: Attempt, *, grips: bool = True) -> Simulated:
    """Return the attempt as performed by the task's expert, without rendering. A success gets its distractors.

    Args:
        grips: whether fingers close. Without, every task that needs a grasp fails.
    """
    if attempt.start is None:
        return Simulated(attempt, Outcome(False, Cause.NO_LAYOUT, no_start(simulator, attempt)), None)
    task = simulator.config.task
    episode = open_episode(simulator, attempt, EXPERT_RULES)
    rng = generator(attempt.job, Stream.SEARCH)
    bench = simulator.expert_tools.bench(episode.world, list(start_stands(simulator.config)), rng)
    log, recoveries = RecoveryLog(), list[Recovery]()

    def note_recoveries() -> None:
        new = log.recoveries[len(recoveries) :]
        recoveries.extend(Recovery(entry.step, entry.skill, entry.detail, episode.frames) for entry in new)

    failure: tuple[Cause, str] | None = None
    # After the program, the arms wait until the hold time has passed.
    max_ticks = task.most_ticks - task.timing.settle_ticks - task.hold_ticks
    try:
        for segment in _motions(simulator, episode, bench, log):
            note_recoveries()
            if episode.ticks + segment.ticks > max_ticks:
                failure = Cause.TIME, f"not done after {episode.seconds:.0f} s"
                break
            episode.act(_with_fingers(episode.scene, path_actions(episode.scene, segment.paths), grips))
            if episode.end is not None:
                break
    except SkillFailedError as error:
        failure = error.cause, str(error)
    note_recoveries()
    last = path_actions(episode.scene, bench.wait(max(1, task.timing.settle_ticks + task.hold_ticks)).paths)
    episode.act(_with_fingers(episode.scene, last, grips), until_success=True)
    bench.clear_cache()
    played = episode.finish()
    outcome = replace(outcome_of(simulator, played, failure), recoveries=tuple(recoveries))
    simulated = Simulated(attempt, outcome, played)
    return (
        replace(simulated, attempt=with_distractors(simulator, attempt, simulated.states))
        if outcome.success
        else simulated
    )


def _motions(simulator: Simulator, episode: Episode, bench: Bench, log: RecoveryLog) -> Iterator[Segment]:
    """Yield the motions of a task's expert. Hands are not parked once the goal is reached."""
    task, cast = simulator.config.task, simulator.cast
    yield from run_program(program_of(task, cast), bench, cast, log)
    if not episode.succeeds:
        yield from park_free(bench)


def repeat(
    simulator: Simulator, attempt: Attempt, actions: Actions, rules: EpisodeRules, on_step: OnStep | None = None
) -> Simulated:
    """Return the attempt as performed by given actions, judged like any other.

    Args:
        rules: of the episode in which the actions were recorded; the verdict is then the same.
        on_step: see `Episode`.
    """
    episode = open_episode(simulator, attempt, rules, on_step)
    episode.act(actions)
    played = episode.finish()
    return Simulated(attempt, outcome_of(simulator, played), played)


def outcome_of(simulator: Simulator, played: Played, failure: tuple[Cause, str] | None = None) -> Outcome:
    """Return the outcome of an episode.

    Args:
        failure: cause and details of an expert's failure; None without one.
    """
    end = played.end
    cause, detail = end.cause, end.detail
    if failure is not None and end.reason not in (EndReason.UNSTABLE, EndReason.FORBIDDEN):
        cause, detail = failure
    elif end.cause is Cause.GOAL and _misses_its_target(simulator, played):
        cause = Cause.OFF_TARGET
    dxy, dz, speed = _distances(simulator, played)
    measures = played.verdict.measures if played.verdict else ()
    return Outcome(cause is None, cause, detail, dxy, dz, speed, margins=played.margins, measures=measures)


def with_distractors(simulator: Simulator, attempt: Attempt, states: Sequence[StepState]) -> Attempt:
    """Return the attempt with distractors placed where nothing comes near them; unchanged if the config has none.

    Args:
        states: of the whole attempt.
    """
    if simulator.placer is None:
        return attempt
    places = simulator.placer.places(attempt.job, [state.qpos for state in states])
    return replace(attempt, variation=replace(attempt.variation, distractors=places))


def with_room(simulator: Simulator, attempt: Attempt) -> Attempt:
    """Return the attempt with distractors that leave room for its demonstration, for other actors.

    Nothing is simulated if the config has no distractors. If the demonstration fails, none are placed.
    """
    return attempt if simulator.placer is None else demonstrate(simulator, attempt).attempt


def _misses_its_target(simulator: Simulator, played: Played) -> bool:
    """Return whether the goal fails first at the distance by which the task is scored."""
    target = simulator.config.task.target_predicate
    if target is None or played.verdict is None or played.verdict.reached:
        return False
    worst, cast = played.verdict.worst, simulator.cast
    return worst.unit == "m" and worst.what == f"on({cast.one(target.thing)}, {cast.one(target.surface)})"


def _distances(simulator: Simulator, played: Played) -> tuple[float | None, float | None, float | None]:
    """Return a thing's distance from its target at the end, horizontal and vertical, m; and the thing's speed, m/s.

    All are None for a goal without such a distance.
    """
    task, cast = simulator.config.task, simulator.cast
    target = task.target_predicate
    if target is None:
        return None, None, None
    thing, surface = cast.one(target.thing), cast.one(target.surface)
    apart = played.T_at_end[thing][:3, 3] - played.T_at_end[surface][:3, 3]
    return math.hypot(apart[0], apart[1]), float(apart[2]), played.speeds[thing]


def _with_fingers(scene: CompiledScene, actions: Actions, grips: bool) -> Actions:
    """Return the actions; without grips, with open fingers and magnets off."""
    if grips:
        return actions
    ctrl = actions.ctrl.copy()
    for arm in scene.arms:
        if arm.fingers is not None:
            ctrl[:, arm.fingers.ctrl] = arm.fingers.ctrl_range[1]
    return replace(actions, ctrl=ctrl, magnet=np.zeros_like(actions.magnet))
