from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum

from yamsim_cli.core.attempt_data import ActionSequence, Attempt, AttemptJob, StepState
from yamsim_cli.core.closable import Closable
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.records import OutcomeRecord
from yamsim_cli.core.episode.attempt_payload import render_cameras
from yamsim_cli.core.episode.episode import Episode
from yamsim_cli.core.episode.episode_rules import EpisodeRules
from yamsim_cli.core.episode.execution import build_outcome
from yamsim_cli.core.episode.sampling import sample_attempt
from yamsim_cli.core.episode.simulator import Simulator, SimulatorCache, open_episode
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.images.image import Image
from yamsim_cli.core.workers.job_server import kill_forks_at_exit

from ..action_chunks import ChunkScheduler, ChunkSettings, ChunkStats
from ..policy_faults import PolicyFault
from ..policy_loading import reset_policy, wanted_images, wanted_state
from ..policy_protocol import InvalidActionError, read_chunk
from .grasp_offset import GraspOffsetMonitor, final_offset
from .observation import ObservationBuilder, ObservationRenderer, policy_cameras
from .policy_calls import PolicyCaller, PolicyFailedError, PolicyTimeoutError, output_on_stderr
from .policy_choice import PolicyChoice
from .policy_factory import ExpertPolicy, PrivilegedPolicy, PrivilegedTrial, make_policy, policy_station


class TrialEnd(StrEnum):
    """Reason for the end of a trial. From `RAISED` on, the policy is at fault, and the trial is a failure.

    `SUCCESS`: the goal held for its hold time, under the rule `success`. `DONE`: the policy's answer had `done`.
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


POLICY_FAULT_ENDS = (TrialEnd.RAISED, TrialEnd.INVALID, TrialEnd.SLOW, TrialEnd.LOST)
# Ends that measure the policy's success.
MEASURED_ENDS = (TrialEnd.SUCCESS, TrialEnd.DONE, TrialEnd.TIME_LIMIT, TrialEnd.UNSTABLE)

# Errors of a `PolicyCaller`, and of `read_chunk`, that end a trial.
POLICY_ERRORS = (InvalidActionError, PolicyTimeoutError, PolicyFailedError)
NO_FAULT = PolicyFault("")


@dataclass(frozen=True)
class TrialResult:
    """Result of a trial.

    Attributes:
        ticks: simulated control ticks.
        seconds: duration of each inference, s.
        actions: None if no tick was simulated.
        offset: final position of the task's object from its target (x, y) in `world`, m; None without a target.
        offset_in_hand: position of that object's origin (x, y, z) in `pinch_site` when a hand last grasped it, m; None
            if no hand did.
        chunking: the settings of chunks, with the policy's own values where none are given.
        read_cameras: cameras whose images the policy has read.
    """

    attempt: Attempt
    outcome: OutcomeRecord
    ended: TrialEnd
    error: str = ""
    traceback: str = ""
    ticks: int = 0
    seconds: tuple[float, ...] = ()
    actions: ActionSequence | None = field(default=None, repr=False)
    chunk_stats: ChunkStats = field(default_factory=ChunkStats)
    offset: tuple[float, float] | None = None
    offset_in_hand: tuple[float, float, float] | None = None
    chunking: ChunkSettings | None = None
    read_cameras: frozenset[str] = frozenset()


def describe_policy_error(error: Exception, call_seconds: float, ticks: int) -> tuple[TrialEnd, PolicyFault]:
    """Return how one of `POLICY_ERRORS` ends a trial after `ticks` ticks, and the fault with its sentence.

    Args:
        call_seconds: real time that an answer may take, s.
    """
    if isinstance(error, PolicyTimeoutError):
        return TrialEnd.SLOW, PolicyFault(f"no answer within {call_seconds:g} s, after {ticks} ticks")
    if isinstance(error, PolicyFailedError):
        return TrialEnd.RAISED, PolicyFault(f"{error}, after {ticks} ticks", error.fault.traceback)
    return TrialEnd.INVALID, PolicyFault(str(error))


def trial_rules(config: RecordConfig, choice: PolicyChoice) -> EpisodeRules:
    """Return the rule and time limit that end a trial, from the choice or else the task."""
    task = config.task
    ticks = task.max_ticks if choice.time_limit is None else max(1, round(choice.time_limit / task.timing.tick_seconds))
    return EpisodeRules(choice.end, max_ticks=ticks)


class TrialRunner(Closable):
    """Runs trials of one policy. The caller must close the runner, for example as a context manager.

    Attributes:
        policy: the policy of the trials.
        simulators: simulators of the trials, which trials with the same scene share.

    Raises:
        ConfigError, UsageError, ResourceError: the policy does not exist, cannot be loaded, or does not fit the rig.
    """

    def __init__(self, session: Session, choice: PolicyChoice) -> None:
        self._config, self._choice = session.config, choice
        self._read_cameras: set[str] = set()
        with output_on_stderr(), kill_forks_at_exit():
            self.policy = make_policy(choice, policy_station(session.config), session.locations)
        self._caller = PolicyCaller(choice.call_seconds, choice.folder)
        self.simulators = SimulatorCache(session)
        try:
            self._wanted = wanted_images(self.policy), wanted_state(self.policy)
            execute = choice.chunking.execute or getattr(self.policy, "execute", None)
            self._chunking = replace(choice.chunking, execute=execute, lead=getattr(self.policy, "lead", None))
            policy_cameras(session.config, self._wanted[0])
        except BaseException:
            self.close()  # a connection that stays open would keep the process alive
            raise

    def run(self, job: AttemptJob) -> TrialResult:
        """Run one trial. The expert runs first only if it is the policy, or if distractors must leave room for it."""
        return self.run_with_states(job)[0]

    def run_with_states(self, job: AttemptJob) -> tuple[TrialResult, tuple[StepState, ...]]:
        """Run one trial as `run` does, and return its result and the state of every recorded frame."""
        simulator, policy = self.simulators.get(job), self.policy
        self._read_cameras.clear()
        trial = PrivilegedTrial(simulator, sample_attempt(simulator, job))
        scripted = isinstance(policy, ExpertPolicy)
        if trial.attempt.layout is None or (scripted and not trial.expert_attempt.recorded_states):
            failed = OutcomeRecord.from_outcome(trial.expert_attempt.outcome)
            return TrialResult(trial.attempt, failed, TrialEnd.NOT_STARTED), ()
        attempt = trial.expert_attempt.attempt if simulator.distractor_placer else trial.attempt
        start = policy.prepare_trial(trial) if isinstance(policy, PrivilegedPolicy) else None
        if start is not None:
            attempt = replace(attempt, start=start)
        seconds: list[float] = []
        episode, ended, fault, count, offset_in_hand = self._drive_episode(simulator, attempt, seconds)
        result = episode.end_episode()
        outcome = build_outcome(simulator, result)
        if scripted:
            outcome = replace(outcome, recoveries=trial.expert_attempt.outcome.recoveries)
        record = OutcomeRecord.from_outcome(outcome)
        if ended in POLICY_FAULT_ENDS:
            record = record.model_copy(update={"success": False, "cause": ended.value, "detail": fault.text})
        actions = episode.executed_actions if episode.ticks else None
        trial_result = TrialResult(
            attempt,
            record,
            ended,
            fault.text,
            fault.traceback,
            episode.ticks,
            tuple(seconds),
            actions,
            count,
            final_offset(simulator, result.T_at_end),
            offset_in_hand,
            self._chunking,
            frozenset(self._read_cameras),
        )
        return trial_result, result.states

    def _drive_episode(
        self, simulator: Simulator, attempt: Attempt, seconds: list[float]
    ) -> tuple[Episode, TrialEnd, PolicyFault, ChunkStats, tuple[float, float, float] | None]:
        config = self._config
        episode = open_episode(simulator, attempt, trial_rules(config, self._choice))
        renderer = ObservationRenderer(lambda qpos, camera: self._render_camera(simulator, attempt, qpos, camera))
        observer = ObservationBuilder(simulator, *self._wanted)
        hold = int(getattr(self.policy, "ticks", 1))
        scheduler = ChunkScheduler(
            self._chunking, config.task.timing.tick_seconds, hold, episode.simulated_encoder_readings(attempt.job)
        )
        grasps = GraspOffsetMonitor(simulator, episode)
        try:
            ended, fault = self._run_policy(scheduler, episode, observer, attempt, renderer, seconds, grasps)
        finally:
            renderer.finish()
        return episode, ended, fault, scheduler.chunk_stats, grasps.offset

    def _run_policy(
        self,
        scheduler: ChunkScheduler,
        episode: Episode,
        observer: ObservationBuilder,
        attempt: Attempt,
        renderer: ObservationRenderer,
        seconds: list[float],
        grasps: GraspOffsetMonitor,
    ) -> tuple[TrialEnd, PolicyFault]:
        try:
            self._caller.call(lambda: reset_policy(self.policy, _policy_seed(attempt.job)))
            while episode.end is None and not scheduler.last_chunk_is_over(episode.ticks):
                if scheduler.is_due(episode.ticks):
                    observation = observer.observe(episode, attempt, renderer)
                    answer = self._caller.request(self.policy, observation, renderer)
                    seconds.append(self._caller.seconds)
                    scheduler.add_chunk(read_chunk(answer, *observer.drive_shape), episode.ticks, self._caller.seconds)
                ctrl, magnet = scheduler.command_at(episode.ticks)
                episode.step(ctrl, magnet)
                grasps.measure_tick()
        except POLICY_ERRORS as error:
            return describe_policy_error(error, self._choice.call_seconds, episode.ticks)
        if episode.end is None:
            # Hold the last command while objects settle, and for the goal's hold time.
            for _ in range(self._config.task.timing.settle_ticks + self._config.task.hold_ticks):
                if not episode.has_succeeded:
                    episode.step(ctrl, magnet)
        return TrialEnd.DONE if episode.end is None else TrialEnd(episode.end.reason.value), NO_FAULT

    def _render_camera(self, simulator: Simulator, attempt: Attempt, qpos: Array, camera: str) -> Image:
        self._read_cameras.add(camera)
        with self._caller.paused_limit():
            return render_cameras(simulator, attempt, qpos, (camera,))[camera]

    def close(self) -> None:
        """Close the policy, and release the memory of the renderers."""
        self._caller.close(self.policy)
        self.simulators.close()


def _policy_seed(job: AttemptJob) -> int:
    """Return a seed of 32 bits, which all libraries accept."""
    return (job.seed * 1_000_003 + job.attempt) % 2**32
