"""One trial of a policy, with the start and the verdict of `yamsim trials` for the same numbers."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field, replace
from enum import StrEnum

from yamsim_cli.core.closing import Closing
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.records import OutcomeRecord
from yamsim_cli.core.episode.engine import outcome_of
from yamsim_cli.core.episode.episode import Episode
from yamsim_cli.core.episode.payload import render
from yamsim_cli.core.episode.rules import EpisodeRules
from yamsim_cli.core.episode.sampling import sample
from yamsim_cli.core.episode.simulator import Simulator, Simulators, open_episode
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.images.image import Image
from yamsim_cli.core.types import Actions, Attempt, EpisodeJob
from yamsim_cli.core.workers.serving import forks_end_here

from ..base import InvalidActionError, Observation, read_chunk
from ..chunks import ChunkCount, ChunkPlayer
from ..loading import reset_policy, wanted_images, wanted_state
from ..policy_faults import Fault
from .choice import PolicyChoice
from .observation import ObservationRenderer, Observer, policy_cameras
from .policy_calls import PolicyCaller, PolicyFailedError, TooSlowError, output_on_stderr
from .policy_factory import Privileged, Scripted, Trial, make_policy


class Ended(StrEnum):
    """What ended a trial. From `RAISED` on the policy is at fault, and the trial is no success.

    `SUCCESS`: the goal had held for its hold time, under the rule that ends a trial then. `DONE`: the policy's answer.
    """

    NOT_STARTED = "not_started"
    SUCCESS = "success"
    DONE = "done"
    TIME_LIMIT = "time_limit"
    UNSTABLE = "unstable"
    RAISED = "policy_raised"
    INVALID = "policy_invalid"
    SLOW = "policy_slow"
    LOST = "policy_lost"


FAULTS = (Ended.RAISED, Ended.INVALID, Ended.SLOW, Ended.LOST)
# Ends of trials that measure the policy.
MEASURED = (Ended.SUCCESS, Ended.DONE, Ended.TIME_LIMIT, Ended.UNSTABLE)

_NO_FAULT = Fault("")


@dataclass(frozen=True)
class TrialResult:
    """The result of a trial.

    Attributes:
        attempt: as it began.
        ended: what ended it.
        error: the policy's fault, for a person; empty if there is none.
        traceback: of the policy's exception; empty if there is none.
        ticks: control ticks that passed.
        seconds: duration of each of the policy's answers, s.
        actions: what acted; None if nothing did.
        count: of the policy's actions.
    """

    attempt: Attempt
    outcome: OutcomeRecord
    ended: Ended
    error: str = ""
    traceback: str = ""
    ticks: int = 0
    seconds: tuple[float, ...] = ()
    actions: Actions | None = field(default=None, repr=False)
    count: ChunkCount = field(default_factory=ChunkCount)


def trial_rules(config: RecordConfig, choice: PolicyChoice) -> EpisodeRules:
    """The rules of a policy's trials: who ends them, and their time limit."""
    task = config.task
    ticks = task.most_ticks if choice.time_limit is None else max(1, round(choice.time_limit / task.timing.tick))
    return EpisodeRules(choice.end, max_ticks=ticks)


class TrialRunner(Closing):
    """Runs trials of one policy; a context manager, since it may own a renderer.

    Raises:
        UsageError, ResourceError: the policy cannot be made, see `make_policy`.
    """

    def __init__(self, session: Session, choice: PolicyChoice) -> None:
        self._config, self._choice = session.config, choice
        with output_on_stderr(), forks_end_here():
            self._policy = make_policy(choice, session)
        self._caller = PolicyCaller(choice.call_seconds, choice.folder)
        self._simulators = Simulators(session)
        self._wanted = wanted_images(self._policy), wanted_state(self._policy)
        execute = choice.chunking.execute or getattr(self._policy, "execute", None)
        self._chunking = replace(choice.chunking, execute=execute)
        policy_cameras(session.config, self._wanted[0])

    def run(self, job: EpisodeJob) -> TrialResult:
        """Run one trial. The expert runs first only if the policy is the expert, or distractors have to leave room."""
        simulator, policy = self._simulators.of(job), self._policy
        trial = Trial(simulator, sample(simulator, job))
        scripted = isinstance(policy, Scripted)
        if trial.attempt.layout is None or (scripted and not trial.demonstrated.states):
            failed = OutcomeRecord.of(trial.demonstrated.outcome)
            return TrialResult(trial.attempt, failed, Ended.NOT_STARTED)
        attempt = trial.demonstrated.attempt if simulator.placer else trial.attempt
        start = policy.begin(trial) if isinstance(policy, Privileged) else None
        if start is not None:
            attempt = replace(attempt, start=start)
        seconds: list[float] = []
        episode, ended, fault, count = self._drive(simulator, attempt, seconds)
        played = episode.finish()
        outcome = outcome_of(simulator, played)
        if scripted:
            outcome = replace(outcome, recoveries=trial.demonstrated.outcome.recoveries)
        record = OutcomeRecord.of(outcome)
        if ended in FAULTS:
            record = record.model_copy(update={"success": False, "cause": ended.value, "detail": fault.text})
        actions = episode.actions if episode.ticks else None
        return TrialResult(
            attempt, record, ended, fault.text, fault.traceback, episode.ticks, tuple(seconds), actions, count
        )

    def _drive(
        self, simulator: Simulator, attempt: Attempt, seconds: list[float]
    ) -> tuple[Episode, Ended, Fault, ChunkCount]:
        """Let the policy act until the trial ends, or the policy is done or fails."""
        config = self._config
        episode = open_episode(simulator, attempt, trial_rules(config, self._choice))
        renderer = ObservationRenderer(lambda qpos, camera: self._render(simulator, attempt, qpos, camera))
        observer = Observer(simulator, *self._wanted)
        hold = int(getattr(self._policy, "ticks", 1))
        player = ChunkPlayer(self._chunking, config.task.timing.tick, hold, episode.readings(attempt.job))
        try:
            ended, fault = self._play(player, episode, observer, attempt, renderer, seconds)
        finally:
            renderer.end()
        return episode, ended, fault, player.count

    def _play(
        self,
        player: ChunkPlayer,
        episode: Episode,
        observer: Observer,
        attempt: Attempt,
        renderer: ObservationRenderer,
        seconds: list[float],
    ) -> tuple[Ended, Fault]:
        try:
            self._caller.call(lambda: reset_policy(self._policy, _policy_seed(attempt.job)))
            while episode.end is None and not player.is_over(episode.ticks):
                if player.is_due(episode.ticks):
                    answer = self._answer(observer.observe(episode, attempt, renderer), renderer)
                    seconds.append(self._caller.seconds)
                    player.take(read_chunk(answer, *observer.drives), episode.ticks, self._caller.seconds)
                ctrl, magnet = player.act(episode.ticks)
                episode.step(ctrl, magnet)
        except InvalidActionError as error:
            return Ended.INVALID, Fault(str(error))
        except TooSlowError:
            return Ended.SLOW, Fault(f"no answer within {self._choice.call_seconds:g} s, after {episode.ticks} ticks")
        except PolicyFailedError as error:
            return Ended.RAISED, Fault(f"{error}, after {episode.ticks} ticks", error.fault.traceback)
        if episode.end is None:
            # The policy is done: the last command holds while things settle and for the goal's hold time.
            for _ in range(self._config.task.timing.settle_ticks + self._config.task.hold_ticks):
                if not episode.succeeds:
                    episode.step(ctrl, magnet)
        return Ended.DONE if episode.end is None else Ended(episode.end.reason.value), _NO_FAULT

    def _answer(self, observation: Observation, renderer: ObservationRenderer) -> object:
        """The policy's answer to an observation."""
        try:
            return self._caller.call(lambda: self._policy(observation))
        finally:
            if renderer.failure is not None:
                raise renderer.failure

    def _render(self, simulator: Simulator, attempt: Attempt, qpos: Array, camera: str) -> Image:
        with self._caller.waits():
            return render(simulator, attempt, qpos, (camera,))[camera]

    def close(self) -> None:
        """Close the policy, and free the renderers."""
        close = getattr(self._policy, "close", None)
        if callable(close):
            with contextlib.suppress(PolicyFailedError, TooSlowError):
                self._caller.call(close)
        self._simulators.close()


def _policy_seed(job: EpisodeJob) -> int:
    """A seed for each trial, of 32 bits, which every library accepts."""
    return (job.seed * 1_000_003 + job.attempt) % 2**32
