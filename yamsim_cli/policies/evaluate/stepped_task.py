"""Trials for callers that step the simulation themselves, such as environments and simulated stations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from yamsim_cli.core.attempt_data import ActionSequence, Attempt, AttemptJob
from yamsim_cli.core.closable import Closable
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.attempt_payload import render_cameras
from yamsim_cli.core.episode.episode import Episode
from yamsim_cli.core.episode.episode_rules import EndReason, EndRule, EpisodeRules
from yamsim_cli.core.episode.execution import simulate_expert, with_reserved_distractors
from yamsim_cli.core.episode.sampling import sample_attempt
from yamsim_cli.core.episode.simulator import MAX_SIMULATORS, Simulator, SimulatorCache, open_episode
from yamsim_cli.core.errors import SimulationError
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.images.image import Image

MAX_SKIPPED_TRIALS = 20  # consecutive trials without a start, after which `begin_trial` fails


@dataclass(frozen=True)
class RunningTrial:
    """A trial whose episode its caller steps."""

    simulator: Simulator
    attempt: Attempt
    episode: Episode

    @property
    def is_successful(self) -> bool:
        """Whether the trial ended in success, or would if the actor ended it now."""
        end = self.episode.end
        return self.episode.has_succeeded if end is None else end.cause is None

    @property
    def out_of_time(self) -> bool:
        """Whether the trial ended by its time limit."""
        end = self.episode.end
        return end is not None and end.reason is EndReason.TIME_LIMIT

    def failure_reason(self) -> str:
        """Return why the trial is no success; empty for a success."""
        if self.is_successful:
            return ""
        end = self.episode.end
        return self.episode.goal_status if end is None or not end.detail else end.detail

    def render(self, cameras: Sequence[str], qpos: Array | None = None) -> dict[str, Image]:
        """Return the image (height, width, 3) of each camera, of the current state or of MuJoCo's positions (nq,)."""
        return render_cameras(self.simulator, self.attempt, self.episode.data.qpos if qpos is None else qpos, cameras)


class SteppedTask(Closable):
    """Trials of a task, with the same starts as `yamsim trials`. The caller must close the object.

    A trial takes up to `max_ticks` control ticks, by default the task's limit.

    Args:
        parallel_trials: number of trials that run at the same time, each with a copy of the model if more than one.
    """

    attempt: Attempt
    episode: Episode

    def __init__(
        self,
        session: Session,
        end: EndRule = EndRule.SUCCESS,
        max_ticks: int | None = None,
        *,
        parallel_trials: int = 1,
    ) -> None:
        self.config = session.config
        self.rules = EpisodeRules(end, max_ticks=max_ticks or session.config.task.max_ticks)
        self._own_models = parallel_trials > 1
        self._simulators = SimulatorCache(session, max(parallel_trials, MAX_SIMULATORS))
        self.simulator: Simulator = self._simulators.get(AttemptJob(self.config.seed, 0))

    def begin_trial(self, job: AttemptJob) -> None:
        """Begin the trial `job`, or the next trial for which a start can be sampled."""
        for attempt in self._sampled_attempts(job):
            if attempt.start is not None:
                self._set_up(with_reserved_distractors(self.simulator, attempt))
                return
        raise self._no_start_error(job, "has a start")

    def begin_demonstrated(self, job: AttemptJob) -> ActionSequence:
        """Begin the trial `job`, or the next trial in which the scripted expert succeeds. Return the expert's actions.

        The trial starts like the attempt that `yamsim record` records: same objects, poses, distractors and looks.
        """
        for attempt in self._sampled_attempts(job):
            done = simulate_expert(self.simulator, attempt, disturbed=False)
            if done.outcome.success:
                self._set_up(done.attempt)
                parts = [state.actions for state in done.recorded_states]
                ctrl, magnet, joints = zip(*((part.ctrl, part.magnet, part.joints) for part in parts), strict=True)
                return ActionSequence(np.concatenate(ctrl), np.concatenate(magnet), np.concatenate(joints))
        raise self._no_start_error(job, "can be demonstrated")

    @property
    def trial(self) -> RunningTrial:
        """The present trial."""
        return RunningTrial(self.simulator, self.attempt, self.episode)

    def close(self) -> None:
        """Release the memory of the renderers."""
        self._simulators.close()

    def _sampled_attempts(self, job: AttemptJob) -> Iterator[Attempt]:
        for number in range(job.attempt, job.attempt + MAX_SKIPPED_TRIALS):
            one = replace(job, attempt=number)
            self.simulator = self._simulators.get(one)
            yield sample_attempt(self.simulator, one)

    def _set_up(self, attempt: Attempt) -> None:
        self.attempt = attempt
        self.episode = open_episode(self.simulator, attempt, self.rules, own_model=self._own_models)

    def _no_start_error(self, job: AttemptJob, does: str) -> SimulationError:
        name = self.config.task.name
        return SimulationError(
            f"task {name!r}: of {MAX_SKIPPED_TRIALS} trials of seed {job.seed}, from number {job.attempt} on, "
            f"none {does}; `yamsim trials --task {name} --seed {job.seed}` shows the causes"
        )
