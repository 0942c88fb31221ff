"""Trials: many simulated attempts at a task, with counts and videos."""

from __future__ import annotations

import functools
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from .core.attempt_data import AttemptJob, AttemptPayload, FailureCause
from .core.config.program_task import ProgramTask
from .core.config.recording import SCENE_CAMERA, RecordConfig
from .core.config.session import Session
from .core.dataset.records import MarginsRecord, OutcomeRecord, attempt_record, record_data
from .core.episode.attempt_payload import render_cameras
from .core.episode.episode_rules import EXPERT_RULES
from .core.episode.execution import SimulatedAttempt, simulate_expert
from .core.episode.runner import AttemptRunner, SessionRunner
from .core.episode.sampling import sample_attempt
from .core.episode.simulator import Simulator
from .core.errors import InterruptedJobError, ResourceError, SimulationError, UsageError
from .core.files.writing import move_to_backup
from .core.images.jpeg import decode_jpeg, encode_jpeg
from .core.images.video import VideoWriter, require_encoder
from .core.progress import Progress
from .core.rendering.view_cameras import draw_labels
from .core.statistics import summarize_values, wilson_interval_95
from .core.workers.executors import Executor, J, LostJobError, OpenRunner, run_all
from .core.workers.process_pool import ProcessPool

R = TypeVar("R")

_MOTIONLESS_CAUSES = (FailureCause.NO_LAYOUT, FailureCause.UNREACHABLE)  # failures before any motion
_JPEG_QUALITY = 95  # 0..100, of frames that workers send; the video itself loses much more


def run_expert_trials(session: Session, thresholds: Sequence[float], progress: Progress) -> dict[str, Any]:
    """Simulate `config.episodes` trials by the expert: the attempts that `record` makes with the same seed.

    Args:
        thresholds: distances from the target (m) that are scored as successes, besides the task's own.

    Returns:
        JSON-ready: the figures of `count_outcomes`, margins, rig, task, grasp, acting arms, seconds, trials.
    """
    began = time.monotonic()
    config = session.config
    n = config.episodes
    factory = functools.partial(AttemptRunner, session.without_meshes(), render=False)
    workers = min(config.workers, n)
    with ProcessPool[AttemptJob, AttemptPayload](factory, workers) as pool:
        payloads = run_trials(pool, config.seed, n, progress)
    seconds = time.monotonic() - began

    payloads.sort(key=lambda payload: payload.job.attempt)
    records = [attempt_record(payload, None) for payload in payloads]
    trials = []
    for record in records:
        trial = record_data(record)
        trial["trial"] = trial.pop("attempt")
        del trial["episode"]
        trials.append(trial)
    return {
        **count_outcomes([record.outcome for record in records], config.task, thresholds, [True] * n),
        "margins": _worst_margins([record.outcome.margins for record in records if record.outcome.margins]),
        **trial_settings(config),
        "end_rule": EXPERT_RULES.end.value,
        "seconds": seconds,
        "core_seconds_per_trial": seconds * workers / n,
        "trials": trials,
    }


def _worst_margins(margins: Sequence[MarginsRecord]) -> dict[str, float | None] | None:
    if not margins:
        return None
    slips = [margin.slip_m for margin in margins if margin.slip_m is not None]
    tilts = [margin.object_tilt_rad for margin in margins if margin.object_tilt_rad is not None]
    return {
        "velocity_share": max(margin.velocity_share for margin in margins),
        "torque_share": max(margin.torque_share for margin in margins),
        "joint_rad": min(margin.joint_rad for margin in margins),
        "slip_m": max(slips, default=None),
        "object_tilt_rad": max(tilts, default=None),
    }


def run_trials(
    pool: Executor[AttemptJob, R],
    seed: int,
    n: int,
    progress: Progress,
    lost: Callable[[LostJobError], R] | None = None,
) -> list[R]:
    """Return the results of the first `n` trials of a seed, in no particular order.

    `lost` returns the result of a trial whose workers died or hung; None raises the `LostJobError`.
    """
    results: list[R] = []
    try:
        for _, result in run_all(pool, (AttemptJob(seed, number) for number in range(n)), lost):
            results.append(result)
            progress(len(results), n)
    except KeyboardInterrupt:
        raise InterruptedJobError(
            f"interrupted after {len(results)} of {n} trials; run again to count them all"
        ) from None
    return results


def trial_settings(config: RecordConfig) -> dict[str, Any]:
    """Return the settings of trials, JSON-ready."""
    return {
        "rig": config.rig.name,
        "task": config.task.name,
        "grasp": config.grasp,
        "arms": [config.rig.arms[k].side for k in config.acting_indices],
        "seed": config.seed,
    }


def count_outcomes(
    outcomes: Sequence[OutcomeRecord], task: ProgramTask, thresholds: Sequence[float], valid: Sequence[bool]
) -> dict[str, Any]:
    """Return counts and rates of outcomes, JSON-ready.

    Args:
        thresholds: distances from the target (m) that are scored as successes, if the goal measures one.
        valid: whether each outcome may count as a success at any threshold.

    Returns:
        n, n_success, success_rate, wilson95, threshold_m, rates per threshold, dxy_m, causes, recovered (successes in
        which a skill was tried again).
    """
    n, succeeded = len(outcomes), sum(outcome.success for outcome in outcomes)
    target = task.target_predicate

    def success_rate_within(threshold: float) -> float:
        within = (outcome.is_within(threshold) for outcome in outcomes)
        return sum(near and counts for near, counts in zip(within, valid, strict=True)) / n

    return {
        "n": n,
        "n_success": succeeded,
        "success_rate": succeeded / n,
        "wilson95": wilson_interval_95(succeeded, n),
        "threshold_m": target and target.radius,
        "rates": {f"{threshold:g}": success_rate_within(threshold) for threshold in thresholds} if target else {},
        "dxy_m": summarize_values([outcome.dxy_m for outcome in outcomes if outcome.dxy_m is not None]),
        "causes": dict(Counter(outcome.cause for outcome in outcomes if outcome.cause)),
        "recovered": sum(bool(outcome.recoveries) for outcome in outcomes if outcome.success),
    }


def require_success(counts: Mapping[str, Any], minimum: float | None) -> None:
    """Raise SimulationError if the `counts` of `count_outcomes` have a success rate below `minimum`."""
    if minimum is not None and counts["success_rate"] < minimum:
        raise SimulationError(
            f"{counts['n_success']} of {counts['n']} trials succeeded, a share of {counts['success_rate']:.3g}; "
            f"--min-success requires {minimum:g}"
        )


@dataclass(frozen=True)
class FilmedTrial:
    """A trial and its video."""

    trial: int
    path: Path


class TrialFrameRenderer(SessionRunner):
    """Base of filmers, which render simulated trials."""

    def _render_jpegs(self, simulator: Simulator, done: SimulatedAttempt) -> list[bytes]:
        shown = (render_cameras(simulator, done.attempt, state.qpos, (SCENE_CAMERA,)) for state in done.recorded_states)
        return [encode_jpeg(images[SCENE_CAMERA], _JPEG_QUALITY) for images in shown]


class _ExpertFilmer(TrialFrameRenderer):
    def run(self, job: AttemptJob) -> list[bytes]:
        """Return the trial's frames as JPEGs, for any outcome."""
        simulator = self._simulators.get(job)
        return self._render_jpegs(simulator, simulate_expert(simulator, sample_attempt(simulator, job)))


class TrialVideoWriter:
    """Writes videos of trials: one file if `path` ends in `.mp4`, else a folder with a file per trial.

    `frame_period` is in s. With `overwrite`, an existing `path` becomes a backup; else it raises UsageError unless
    empty.
    """

    def __init__(self, path: Path, frame_period: float, *, overwrite: bool) -> None:
        require_encoder()
        self.path = path
        self._period = frame_period
        self._overwrite = overwrite
        self._single_video = (
            VideoWriter(path, frame_period, overwrite=overwrite) if path.suffix.lower() == ".mp4" else None
        )
        self.moved_aside: Path | None = None
        if not self._single_video and path.exists() and not overwrite and (not path.is_dir() or any(path.iterdir())):
            raise UsageError(f"{path} is not empty; move it aside with --overwrite, or choose another --video")

    def write(self, trials: Iterator[tuple[dict[str, Any], list[bytes]]]) -> list[FilmedTrial]:
        """Write trials and their frames, in order; raises ResourceError if the disk refuses."""
        if self._single_video:
            with self._single_video as video:
                shown = [_write_frames(video, trial, frames) for trial, frames in trials]
            self.moved_aside = self._single_video.moved_aside
            return [FilmedTrial(number, self.path) for number in shown]
        self._make_folder()
        films = []
        for trial, frames in trials:
            path = self.path / f"trial_{trial['trial']:06d}_{_outcome_suffix(trial)}.mp4"
            with VideoWriter(path, self._period) as video:
                films.append(FilmedTrial(_write_frames(video, trial, frames), path))
        return films

    def _make_folder(self) -> None:
        try:
            if self._overwrite and self.path.exists():
                self.moved_aside = move_to_backup(self.path)
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ResourceError(f"{self.path} cannot be made: {error.strerror}; choose another --video") from error


def _outcome_suffix(trial: Mapping[str, Any]) -> str:
    return str(trial["outcome"]["cause"] or "success")


def _write_frames(video: VideoWriter, trial: Mapping[str, Any], frames: Sequence[bytes]) -> int:
    number = int(trial["trial"])
    for data in frames:
        image = decode_jpeg(data)
        if image is None:
            raise SimulationError(f"a frame of trial {number} was damaged in transfer from the worker")
        video.write(draw_labels(image, {}, f"trial {number}: {_outcome_suffix(trial).replace('_', ' ')}"))
    return number


def film_trials(
    trials: Sequence[dict[str, Any]], limit: int, films: TrialVideoWriter, session: Session, progress: Progress
) -> list[FilmedTrial]:
    """Film at most `limit` trials of `run_expert_trials` in which something moved, failures first."""
    moving = [trial for trial in trials if trial["outcome"]["cause"] not in _MOTIONLESS_CAUSES]
    chosen = sorted(moving, key=lambda trial: trial["outcome"]["success"])[:limit]
    if not chosen:
        return []
    factory = functools.partial(_ExpertFilmer, session)
    jobs = [AttemptJob(trial["seed"], trial["trial"]) for trial in chosen]
    return film_jobs(factory, chosen, jobs, films, session.config.workers, progress)


def film_jobs(
    factory: OpenRunner[J, list[bytes]],
    trials: Sequence[dict[str, Any]],
    jobs: Sequence[J],
    films: TrialVideoWriter,
    workers: int,
    progress: Progress,
) -> list[FilmedTrial]:
    """Write trials to videos; each trial's job renders its frames in a worker. Raises as `film_trials`."""
    try:
        with ProcessPool[J, list[bytes]](factory, min(workers, len(jobs))) as pool:
            return films.write(_with_frames(trials, jobs, pool, progress))
    except KeyboardInterrupt:
        raise InterruptedJobError(f"interrupted while filming into {films.path}; finished films are complete") from None


def _with_frames(
    trials: Sequence[dict[str, Any]], jobs: Sequence[J], pool: Executor[J, list[bytes]], progress: Progress
) -> Iterator[tuple[dict[str, Any], list[bytes]]]:
    numbers = {id(job): number for number, job in enumerate(jobs)}
    results = run_all(pool, jobs)
    finished: dict[int, list[bytes]] = {}
    for number, trial in enumerate(trials):
        while number not in finished:
            job, frames = next(results)
            finished[numbers[id(job)]] = frames
        yield trial, finished.pop(number)
        progress(number + 1, len(trials))
