from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...disturbed_motion import DisturbedExecution, run_with_pushes
from ..attempt_data import ActionSequence, Attempt, FailureCause, JointPath, Outcome, Recovery, StepState
from ..expert.planning.arm_solvers import start_postures
from ..expert.skills.common_motions import park_free_hands
from ..expert.skills.planning_context import MotionSegment, PlanningContext, SkillFailedError
from ..expert.skills.program import RecoveryLog, build_program, run_program, skill_object
from ..scene.compiled import CompiledScene
from ..scene.random_streams import Stream, random_generator
from .commands import path_actions
from .episode import Episode, EpisodeResult, PhysicsStepCallback
from .episode_rules import EXPERT_RULES, REPLAY_RULES, EndReason, EpisodeRules
from .sampling import describe_missing_start
from .simulator import Simulator, open_episode

Takeover = Callable[[Episode, PlanningContext], Iterable[MotionSegment]]  # acts, and returns the expert's first motions


@dataclass(frozen=True)
class SimulatedAttempt:
    """An attempt, with the distractors placed after its simulation, and its result; None if nothing moved."""

    attempt: Attempt
    outcome: Outcome
    result: EpisodeResult | None

    @property
    def recorded_states(self) -> tuple[StepState, ...]:
        """The state of every recorded frame."""
        return self.result.states if self.result else ()


def simulate_expert(
    simulator: Simulator, attempt: Attempt, *, grips: bool = True, disturbed: bool = True, after: Takeover | None = None
) -> SimulatedAttempt:
    """Simulate an attempt by the task's expert, without rendering. If it succeeds, place its distractors.

    Without `grips`, fingers do not close. `disturbed`: as the config says. `after`: acts first; a policy may touch all.
    """
    if attempt.start is None:
        return SimulatedAttempt(
            attempt, Outcome(False, FailureCause.NO_LAYOUT, describe_missing_start(simulator, attempt)), None
        )
    task = simulator.config.task
    program, to_actions = build_program(task, simulator.roles), functools.partial(_path_actions, simulator.scene, grips)
    picked = [skill_object(skill, simulator.roles) for skill in program if skill.LEAVES_OBJECT_HELD]
    episode = open_episode(simulator, attempt, EXPERT_RULES if after is None else REPLAY_RULES)
    execution = DisturbedExecution(simulator.config, attempt.job, episode, to_actions, picked if disturbed else None)
    attempt = replace(attempt, variation=replace(attempt.variation, pushes=execution.pushes))
    rng = random_generator(attempt.job, Stream.PLANNING)
    context = simulator.expert_planner.planning_context(episode.world, list(start_postures(simulator.config)), rng)
    log, recoveries = RecoveryLog(), list[Recovery]()

    def append_recoveries() -> None:
        new = log.recoveries[len(recoveries) :]
        recoveries.extend(Recovery(entry.step, entry.skill, entry.detail, episode.frame_count) for entry in new)

    failure: tuple[FailureCause, str] | None = None
    # After the program, the arms wait until the hold time has passed.
    begun = () if after is None else after(episode, context)
    max_ticks = episode.ticks + task.max_ticks - task.timing.settle_ticks - task.hold_ticks
    motions = execution.with_replanning(run_program(program, context, simulator.roles, log), SkillFailedError)
    try:
        for segment in _all_motions(begun, motions, episode, context):
            append_recoveries()
            if episode.ticks + segment.tick_count > max_ticks:
                failure = FailureCause.TIME, f"the program was not done after {episode.simulated_seconds:.0f} s"
                break
            execution.run(segment.paths)
            if episode.end is not None:
                break
    except SkillFailedError as error:
        failure = error.cause, str(error)
    append_recoveries()
    last = context.wait_segment(max(1, task.timing.settle_ticks + task.hold_ticks))
    execution.run(last.paths, until_success=True)
    context.clear_cache()
    played = episode.end_episode()
    played = replace(played, states=execution.with_intended_commands(played.states))
    outcome = replace(build_outcome(simulator, played, failure), recoveries=tuple(recoveries))
    attempt = with_distractors(simulator, attempt, played.states) if outcome.success and after is None else attempt
    return SimulatedAttempt(attempt, outcome, played)


def _all_motions(
    begun: Iterable[MotionSegment], program: Iterator[MotionSegment], episode: Episode, context: PlanningContext
) -> Iterator[MotionSegment]:
    """Yield the motions `begun` and the program's, then move hands to their ready postures unless the goal holds."""
    yield from begun
    yield from program
    if not episode.has_succeeded:
        yield from park_free_hands(context)


def simulate_actions(
    simulator: Simulator,
    attempt: Attempt,
    actions: ActionSequence,
    rules: EpisodeRules,
    on_step: PhysicsStepCallback | None = None,
) -> SimulatedAttempt:
    """Simulate an attempt with given actions. The rules of their recording give the same verdict."""
    episode = open_episode(simulator, attempt, rules, on_step)
    run_with_pushes(episode, actions, attempt.variation.pushes)
    played = episode.end_episode()
    return SimulatedAttempt(attempt, build_outcome(simulator, played), played)


def build_outcome(
    simulator: Simulator, result: EpisodeResult, failure: tuple[FailureCause, str] | None = None
) -> Outcome:
    """Return the outcome of an episode; `failure` is an expert's failure."""
    end = result.end
    cause, detail = end.cause, end.detail
    if failure is not None and end.reason not in (EndReason.UNSTABLE, EndReason.FORBIDDEN):
        cause, detail = failure
    elif end.cause is FailureCause.GOAL and _is_off_target(simulator, result):
        cause = FailureCause.OFF_TARGET
    dxy, dz, speed = _final_distances_and_speed(simulator, result)
    measures = result.verdict.measures if result.verdict else ()
    return Outcome(cause is None, cause, detail, dxy, dz, speed, margins=result.margins, measures=measures)


def with_distractors(simulator: Simulator, attempt: Attempt, states: Sequence[StepState]) -> Attempt:
    """Return the attempt with distractors clear of all its `recorded_states`."""
    if simulator.distractor_placer is None:
        return attempt
    places = simulator.distractor_placer.sample_poses(attempt.job, [state.qpos for state in states])
    return replace(attempt, variation=replace(attempt.variation, distractors=places))


def with_reserved_distractors(simulator: Simulator, attempt: Attempt) -> Attempt:
    """Return the attempt, for other actors, with distractors clear of the expert's motion.

    The demonstration is simulated only if the config has distractors. If it fails, none are placed.
    """
    none = simulator.distractor_placer is None
    return attempt if none else simulate_expert(simulator, attempt, disturbed=False).attempt


def _is_off_target(simulator: Simulator, result: EpisodeResult) -> bool:
    """Return whether the first predicate that fails is the one whose distance scores the task."""
    target = simulator.config.task.target_predicate
    if target is None or result.verdict is None or result.verdict.reached:
        return False
    worst, roles = result.verdict.worst, simulator.roles
    return worst.unit == "m" and worst.what == f"on({roles.object_of(target.thing)}, {roles.object_of(target.surface)})"


def _final_distances_and_speed(
    simulator: Simulator, result: EpisodeResult
) -> tuple[float | None, float | None, float | None]:
    """Return an object's horizontal and vertical distance from its target, m, and its speed, m/s."""
    task, roles = simulator.config.task, simulator.roles
    target = task.target_predicate
    if target is None:
        return None, None, None
    thing, surface = roles.object_of(target.thing), roles.object_of(target.surface)
    apart = result.T_at_end[thing][:3, 3] - result.T_at_end[surface][:3, 3]
    return math.hypot(apart[0], apart[1]), float(apart[2]), result.speeds[thing]


def _path_actions(scene: CompiledScene, grips: bool, paths: Sequence[JointPath]) -> ActionSequence:
    actions = path_actions(scene, paths)
    if grips:
        return actions
    ctrl = actions.ctrl.copy()
    for arm in scene.arms:
        if arm.fingers is not None:
            ctrl[:, arm.fingers.ctrl] = arm.fingers.ctrl_range[1]
    return replace(actions, ctrl=ctrl, magnet=np.zeros_like(actions.magnet))
