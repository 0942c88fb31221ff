"""Retry limit of a recording: stop if no attempt of the task can succeed, or too few succeed.

Ten failures with one cause prove little: a task with success rate 1/5 starts with them in one of nine recordings. If
the cause depends only on geometry, the starts of a hundred more attempts are checked without physics. A task with
success rate 1/5 is then wrongly stopped in one of 4e10 recordings (0.8 ** 110), with rate 1/10 in one of 1e5. If the
cause depends on physics, recording stops after a hundred attempts without success. For the same success rates, that is
wrong in one of 5e9 and one of 4e4 recordings.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ..core.attempt_data import AttemptJob, FailureCause
from ..core.config.goals.world import TABLE
from ..core.config.recording import RecordConfig
from ..core.config.session import Session
from ..core.dataset.records import AttemptRecord
from ..core.episode.sampling import sample_object_placements
from ..core.episode.simulator import SimulatorCache
from ..core.errors import PartialJobError, SimulationError, YamsimError
from ..core.expert.skills.program import build_program

SAME_CAUSE_LIMIT = 10  # first attempts; if all fail for one cause, the starts of `CHECKED_STARTS` more are checked
CHECKED_STARTS = 100  # attempts, after `SAME_CAUSE_LIMIT` failures
MIN_ATTEMPTS = 100  # a task without a success among these is considered impossible
_ATTEMPTS_PER_EPISODE = 20  # a task that needs more per episode succeeds too rarely

HAND_HEIGHT = 0.05  # m above the table, assumed height of grasps

# Failure cause -> parts of a task to inspect.
_TASK_PARTS_OF_CAUSE: Mapping[str, str] = {
    FailureCause.NO_LAYOUT: "`starts` (their regions and `apart`), and the sizes of the objects",
    FailureCause.UNREACHABLE: "`starts`, the steps of `expert`, and where the rig's arms stand",
    FailureCause.SLIPPED: "the object's `grasp.friction` and mass",
    FailureCause.DROPPED: "the object's `grasp`, and what it is put on",
    FailureCause.COLLIDED: "`start_joints`, and `collision` of the objects",
    FailureCause.LIMITS: "`starts`, and `start_joints`",
    FailureCause.OFF_TARGET: "the radius in `goal`, and `collision` and `contact` of both objects",
    FailureCause.UNSTABLE: "`timing` (timestep, settle_ticks), `start_joints`, and the objects' masses and inertias",
    FailureCause.GOAL: "`goal`, and the steps of `expert` that lead to it",
    FailureCause.TIME: "`time_limit_s`, and how many steps `expert` has",
    FailureCause.WORKER_LOST: "the machine, by `yamsim doctor`",
}


class RetryLimitError(PartialJobError):
    """A task succeeds too rarely. Recorded episodes are complete, and `--resume` would not help."""


AllStartsFailFunction = Callable[[FailureCause, int], bool]  # (cause, first attempt) -> whether all starts fail


class RetryLimit:
    """Decides from the outcomes so far when to stop. The number of workers has no effect."""

    def __init__(self, config: RecordConfig, no_better_start: AllStartsFailFunction) -> None:
        self._name, self._wanted = config.task.name, config.episodes
        self._no_better_start = no_better_start
        self._checked = False

    @property
    def max_attempts(self) -> int:
        """Number of attempts after which the recording stops in any case."""
        return max(MIN_ATTEMPTS, _ATTEMPTS_PER_EPISODE * self._wanted)

    def stop_error(self, attempts: Sequence[AttemptRecord], episodes: int) -> YamsimError | None:
        """Return the error that stops a recording after `attempts`; None to continue."""
        tried, last = len(attempts), attempts[-1].outcome if attempts else None
        if last is None or (episodes and tried < self.max_attempts):
            return None
        if episodes:
            rest = f"only {episodes} succeeded, and at least 1 of {_ATTEMPTS_PER_EPISODE} must"
            return RetryLimitError(f"gave up after {tried} attempts: {rest}; {self._causes_text(attempts)}")
        if tried >= MIN_ATTEMPTS:
            return self._infeasible_task_error(f"none of {tried} attempts succeeded", attempts)
        causes = {attempt.outcome.cause for attempt in attempts}
        if tried < SAME_CAUSE_LIMIT or len(causes) > 1 or self._checked:
            return None
        self._checked = True
        if not self._no_better_start(FailureCause(str(last.cause)), tried):
            return None
        more = (
            f"its first {tried} attempts failed with the same cause, and the starts of {CHECKED_STARTS} more have the "
            "same problem"
        )
        return self._infeasible_task_error(more, attempts)

    def _infeasible_task_error(self, why: str, attempts: Sequence[AttemptRecord]) -> SimulationError:
        return SimulationError(
            f"task {self._name!r} cannot succeed: {why}; {self._causes_text(attempts)}; after a change, record with "
            "--overwrite, or to another --out"
        )

    @staticmethod
    def _causes_text(attempts: Sequence[AttemptRecord]) -> str:
        failed = [attempt for attempt in attempts if not attempt.outcome.success]
        counts = Counter(str(attempt.outcome.cause) for attempt in failed).most_common()
        commonest = counts[0][0]
        detail = next(each.outcome.detail for each in reversed(failed) if each.outcome.cause == commonest)
        listed = ", ".join(f"{count} {cause}" for cause, count in counts)
        advice = _TASK_PARTS_OF_CAUSE.get(commonest)
        return f"{listed} ({detail})" + (f"; look at {advice}" if advice else "")


def all_starts_fail(session: Session, cause: FailureCause, first: int) -> bool:
    """Whether all starts from attempt `first` on fail for `cause`; False for causes that depend on physics."""
    if cause not in (FailureCause.NO_LAYOUT, FailureCause.UNREACHABLE):
        return False
    with SimulatorCache(session.without_meshes()) as simulators:
        return not any(
            _start_is_feasible(simulators, cause, AttemptJob(session.config.seed, number))
            for number in range(first, first + CHECKED_STARTS)
        )


def _start_is_feasible(simulators: SimulatorCache, cause: FailureCause, job: AttemptJob) -> bool:
    """Whether the objects have room and, for `UNREACHABLE`, whether grippers reach all objects to be grasped.

    Without that, the program fails.
    """
    simulator = simulators.get(job)
    places = sample_object_placements(simulator, job)
    if isinstance(places, str) or cause is FailureCause.NO_LAYOUT:
        return not isinstance(places, str)
    task, cast = simulator.config.task, simulator.roles
    grasped = {
        thing
        for skill in build_program(task, cast)
        if skill.REQUIRES_HELD_OBJECT is False
        for _, thing in skill.roles()[:1]
    }
    top = simulator.config.widened_table.top_height
    return all(
        simulator.expert_planner.is_place_reachable(np.array([*places[name].T[:2, 3], top + HAND_HEIGHT]))
        for thing in grasped
        for name in cast.objects_of(thing)
        if places[name].support_name == TABLE
    )
