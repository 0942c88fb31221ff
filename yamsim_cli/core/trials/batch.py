"""Run a task many times in physics alone, and count."""

from __future__ import annotations

import functools
import time
from collections.abc import Sequence
from typing import Any

from ..attempt.runner import EpisodeRunner
from ..dataset.records import MarginsRecord, attempt_record, plain
from ..episode.rules import EXPERT_RULES
from ..progress import Progress
from ..session import Session
from ..types import EpisodeJob, EpisodePayload
from ..workers.processes import WorkerPool
from .tally import run_trials, tally, what_ran


def run_batch(session: Session, thresholds: Sequence[float], progress: Progress) -> dict[str, Any]:
    """Run as many trials as the config has `episodes`, the same that `record` would make with the same seed.

    Args:
        thresholds: in metres, by which the outcomes are scored beside the task's own.

    Returns:
        JSON-ready: what `tally` counts, margins, rig, task, grasp, arms (those that act), seconds, trials.

    Raises:
        InterruptedJobError: stopped by the user; nothing is lost but the time.
    """
    began = time.monotonic()
    config = session.config
    n = config.episodes
    factory = functools.partial(EpisodeRunner, session.without_meshes(), render=False)
    workers = min(config.workers, n)
    with WorkerPool[EpisodeJob, EpisodePayload](factory, workers) as pool:
        payloads = run_trials(pool, config.seed, n, progress)
    seconds = time.monotonic() - began

    payloads.sort(key=lambda payload: payload.job.attempt)
    records = [attempt_record(payload, None) for payload in payloads]
    trials = []
    for record in records:
        trial = plain(record)
        trial["trial"] = trial.pop("attempt")
        del trial["episode"]
        trials.append(trial)
    return {
        **tally(
            [record.outcome for record in records],
            config.task,
            thresholds,
            [True] * n,
        ),
        "margins": _worst([record.outcome.margins for record in records if record.outcome.margins]),
        **what_ran(config),
        "end_rule": EXPERT_RULES.end.value,
        "seconds": seconds,
        "core_seconds_per_trial": seconds * workers / n,
        "trials": trials,
    }


def _worst(margins: Sequence[MarginsRecord]) -> dict[str, float | None] | None:
    """The worst of each margin over all trials; None if nothing ever moved."""
    if not margins:
        return None
    return {
        "velocity_share": max(margin.velocity_share for margin in margins),
        "torque_share": max(margin.torque_share for margin in margins),
        "joint_rad": min(margin.joint_rad for margin in margins),
        "slip_m": max((margin.slip_m for margin in margins if margin.slip_m is not None), default=None),
        "object_tilt_rad": max(
            (margin.object_tilt_rad for margin in margins if margin.object_tilt_rad is not None), default=None
        ),
    }
