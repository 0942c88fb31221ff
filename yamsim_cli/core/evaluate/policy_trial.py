"""One trial of a policy: from the start that `yamsim trials` makes of the same numbers, and judged as there."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field, replace
from enum import StrEnum

from ..attempt.engine import outcome_of
from ..attempt.episodes import open_episode
from ..attempt.pictures import render
from ..attempt.sampling import sample
from ..attempt.simulator import Simulator
from ..attempt.simulators import Simulators
from ..closing import Closing
from ..config.recording import RecordConfig
from ..dataset.records import OutcomeRecord
from ..episode.episode import Episode
from ..episode.rules import EpisodeRules
from ..geometry.se3 import Array
from ..images.image import Image
from ..policies.base import InvalidActionError, Observation, read_chunk
from ..policies.chunks import ChunkCount, ChunkPlayer
from ..policies.loading import reset_policy, wanted_images, wanted_state
from ..policies.policy_faults import Fault
from ..session import Session
from ..types import Actions, Attempt, EpisodeJob
from ..workers.serving import forks_end_here
from .asking import Asker, PolicyFailedError, TooSlowError, talking_on_stderr
from .builtin_policies import Privileged, Scripted, Trial, make_policy
from .choice import PolicyChoice
from .observation import Observer, Pictures, policy_cameras


class Ended(StrEnum):
    """What ended a trial. From `RAISED` on it is the policy's fault, and no success whatever the object does.

    `SUCCESS`: the goal had held for its hold time, under the rule that ends a trial then. `DONE`: the policy said so.
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
# The policy had its say to the end.
MEASURED = (Ended.SUCCESS, Ended.DONE, Ended.TIME_LIMIT, Ended.UNSTABLE)

_NO_FAULT = Fault("")


@dataclass(frozen=True)
class TrialResult:
    """How a trial went.

    Attributes:
        attempt: as it began.
        ended: what ended it.
        error: what the policy did wrong, for a person; empty if nothing.
        traceback: of what it raised; empty if it raised nothing.
        ticks: control ticks that passed.
        seconds: how long each of the policy's answers took.
        actions: what acted; None if nothing did.
        count: what became of the actions that it answered with.
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
    """Return the rules of a policy's trials: who ends them, and how many control ticks they may take."""
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
        with talking_on_stderr(), forks_end_here():
            self._policy = make_policy(choice, session)
        self._asker = Asker(choice.call_seconds, choice.folder)
        self._simulators = Simulators(session)
        self._wanted = wanted_images(self._policy), wanted_state(self._policy)
        execute = choice.chunking.execute or getattr(self._policy, "execute", None)
        self._chunking = replace(choice.chunking, execute=execute)
        policy_cameras(session.config, self._wanted[0])

    def run(self, job: EpisodeJob) -> TrialResult:
        """One trial. Its attempt is planned only if the policy asks for the plan, or distractors have to leave room."""
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
        told = (fault.text, fault.traceback, episode.ticks, tuple(seconds))
        return TrialResult(attempt, record, ended, *told, episode.actions if episode.ticks else None, count)

    def _drive(
        self, simulator: Simulator, attempt: Attempt, seconds: list[float]
    ) -> tuple[Episode, Ended, Fault, ChunkCount]:
        """Let the policy act until the trial ends, or the policy says that it is done, or fails."""
        config = self._config
        episode = open_episode(simulator, attempt, trial_rules(config, self._choice))
        pictures = Pictures(lambda qpos, camera: self._render(simulator, attempt, qpos, camera))
        observer = Observer(simulator, *self._wanted)
        hold = int(getattr(self._policy, "ticks", 1))
        player = ChunkPlayer(self._chunking, config.task.timing.tick, hold, observer.joints(episode, attempt))
        try:
            ended, fault = self._play(player, episode, observer, attempt, pictures, seconds)
        finally:
            pictures.end()
        return episode, ended, fault, player.count

    def _play(
        self,
        player: ChunkPlayer,
        episode: Episode,
        observer: Observer,
        attempt: Attempt,
        pictures: Pictures,
        seconds: list[float],
    ) -> tuple[Ended, Fault]:
        try:
            self._asker.ask(lambda: reset_policy(self._policy, _policy_seed(attempt.job)))
            while episode.end is None and not player.is_over(episode.ticks):
                if player.is_due(episode.ticks):
                    answer = self._ask(observer.observe(episode, attempt, pictures), pictures)
                    seconds.append(self._asker.seconds)
                    player.take(read_chunk(answer, *observer.drives), episode.ticks, self._asker.seconds)
                ctrl, magnet = player.act(episode.ticks)
                episode.step(ctrl, magnet)
        except InvalidActionError as error:
            return Ended.INVALID, Fault(str(error))
        except TooSlowError:
            return Ended.SLOW, Fault(f"no answer within {self._choice.call_seconds:g} s, after {episode.ticks} ticks")
        except PolicyFailedError as error:
            return Ended.RAISED, Fault(f"{error}, after {episode.ticks} ticks", error.fault.traceback)
        if episode.end is None:
            # The policy is done: everything stands still, for as long as the goal would have to hold.
            for _ in range(self._config.task.timing.settle_ticks + self._config.task.hold_ticks):
                if not episode.succeeds:
                    episode.step(ctrl, magnet)
        return Ended.DONE if episode.end is None else Ended(episode.end.reason.value), _NO_FAULT

    def _ask(self, observation: Observation, pictures: Pictures) -> object:
        """The policy's answer to an observation."""
        try:
            return self._asker.ask(lambda: self._policy(observation))
        finally:
            if pictures.failure is not None:
                raise pictures.failure

    def _render(self, simulator: Simulator, attempt: Attempt, qpos: Array, camera: str) -> Image:
        with self._asker.waits():
            return render(simulator, attempt, qpos, (camera,))[camera]

    def close(self) -> None:
        """Let the policy close what it has open, and free the renderers."""
        close = getattr(self._policy, "close", None)
        if callable(close):
            with contextlib.suppress(PolicyFailedError, TooSlowError):
                self._asker.ask(close)
        self._simulators.close()


def _policy_seed(job: EpisodeJob) -> int:
    """A seed of its own for every trial, of 32 bits, which every library takes."""
    return (job.seed * 1_000_003 + job.attempt) % 2**32
