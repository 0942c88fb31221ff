"""When a recording gives up: its task cannot work, or works too rarely.

Ten failures of one cause prove little: a task that works one time in five starts so in one recording of nine. Where
geometry alone decides on the cause, the starts of a hundred more attempts are therefore checked, without physics. Then
a task that works one time in five is given up wrongly in one recording of 4e10 (0.8 ** 110), and a task that works one
time in ten in one of 1e5. Where physics decides, a task is given up after a hundred attempts without a success: wrongly
in one recording of 5e9, and one of 4e4.
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
from ..core.episode.simulator import Simulators
from ..core.errors import PartialJobError, SimulationError, YamsimError
from ..core.expert.skills.program import build_program

SAME_CAUSE = 10  # first attempts that all fail for one cause, after which more starts are checked
MORE_STARTS = 100  # starts that are checked then
MIN_ATTEMPTS = 100  # attempts that every task is given; a task without a success among them cannot work
_ATTEMPTS_PER_EPISODE = 20  # attempts per wanted episode, after which the task works too rarely

HAND_HEIGHT = 0.05  # m over the table, at which grippers grasp things

# Cause -> parts of a task to look at.
_LOOK_AT: Mapping[str, str] = {
    FailureCause.NO_LAYOUT: "`starts` (their regions and `apart`), and how large the things are",
    FailureCause.UNREACHABLE: "`starts`, the steps of `expert`, and where the rig's arms stand",
    FailureCause.SLIPPED: "the object's `grasp.friction` and mass",
    FailureCause.DROPPED: "the object's `grasp`, and what it is put on",
    FailureCause.COLLIDED: "`start_joints`, and the things' `collision`",
    FailureCause.LIMITS: "`starts`, and `start_joints`",
    FailureCause.OFF_TARGET: "the radius in `goal`, and both things' `collision` and `contact`",
    FailureCause.UNSTABLE: "`timing` (timestep, settle_ticks), `start_joints`, and the objects' masses and inertias",
    FailureCause.GOAL: "`goal`, and the steps of `expert` that are to bring it about",
    FailureCause.TIME: "`time_limit_s`, and how many steps `expert` has",
    FailureCause.WORKER_LOST: "the machine, by `yamsim doctor`",
}


class RetryLimitError(PartialJobError):
    """The task works too rarely; what was recorded is whole, and `--resume` would not help."""


# Whether all attempts from a number on fail for a cause, see `all_starts_fail`.
AllStartsFail = Callable[[FailureCause, int], bool]


class RetryLimit:
    """Decides from the attempts, in their order, when a recording gives up; the number of workers has no effect."""

    def __init__(self, config: RecordConfig, no_better_start: AllStartsFail) -> None:
        self._name, self._wanted = config.task.name, config.episodes
        self._no_better_start = no_better_start
        self._checked = False

    @property
    def most_attempts(self) -> int:
        """The largest number of attempts."""
        return max(MIN_ATTEMPTS, _ATTEMPTS_PER_EPISODE * self._wanted)

    def stop_error(self, attempts: Sequence[AttemptRecord], episodes: int) -> YamsimError | None:
        """The error that ends a recording after `attempts`, of which `episodes` succeeded; None to go on."""
        tried, last = len(attempts), attempts[-1].outcome if attempts else None
        if last is None or (episodes and tried < self.most_attempts):
            return None
        if episodes:
            rest = f"the task works too rarely, {episodes} of {tried} times and at least 1 in {_ATTEMPTS_PER_EPISODE} "
            return RetryLimitError(f"gave up after {tried} attempts: {rest}is needed; {self._causes(attempts)}")
        if tried >= MIN_ATTEMPTS:
            return self._cannot_work(f"none of {tried} attempts succeeded", attempts)
        causes = {attempt.outcome.cause for attempt in attempts}
        if tried < SAME_CAUSE or len(causes) > 1 or self._checked:
            return None
        self._checked = True
        if not self._no_better_start(FailureCause(str(last.cause)), tried):
            return None
        more = f"its first {tried} attempts all failed in one way, and {MORE_STARTS} more would start no better"
        return self._cannot_work(more, attempts)

    def _cannot_work(self, why: str, attempts: Sequence[AttemptRecord]) -> SimulationError:
        return SimulationError(
            f"task {self._name!r} cannot work as it is: {why}; {self._causes(attempts)}; then record with "
            "--overwrite, or to another --out"
        )

    @staticmethod
    def _causes(attempts: Sequence[AttemptRecord]) -> str:
        """Counts of causes, the last detail of the commonest cause, and what to look at."""
        failed = [attempt for attempt in attempts if not attempt.outcome.success]
        counts = Counter(str(attempt.outcome.cause) for attempt in failed).most_common()
        commonest = counts[0][0]
        detail = next(each.outcome.detail for each in reversed(failed) if each.outcome.cause == commonest)
        listed = ", ".join(f"{count} {cause}" for cause, count in counts)
        advice = _LOOK_AT.get(commonest)
        return f"{listed} ({detail})" + (f"; look at {advice}" if advice else "")


def all_starts_fail(session: Session, cause: FailureCause, first: int) -> bool:
    """Whether the starts of all `MORE_STARTS` attempts from number `first` on fail for a cause.

    False for causes that depend on physics.
    """
    if cause not in (FailureCause.NO_LAYOUT, FailureCause.UNREACHABLE):
        return False
    with Simulators(session.without_meshes()) as simulators:
        return not any(
            _start_is_feasible(simulators, cause, AttemptJob(session.config.seed, number))
            for number in range(first, first + MORE_STARTS)
        )


def _start_is_feasible(simulators: Simulators, cause: FailureCause, job: AttemptJob) -> bool:
    """Whether an attempt's things have room and, for `UNREACHABLE`, whether grippers reach all things to be grasped.

    Programs need more than that, so that a program fails wherever this check fails.
    """
    simulator = simulators.get(job)
    places = sample_object_placements(simulator, job)
    if isinstance(places, str) or cause is FailureCause.NO_LAYOUT:
        return not isinstance(places, str)
    task, cast = simulator.config.task, simulator.roles
    grasped = {
        thing for skill in build_program(task, cast) if skill.NEEDS_HELD is False for _, thing in skill.roles()[:1]
    }
    top = simulator.config.table.top
    return all(
        simulator.expert_tools.is_place_reachable(np.array([*places[name].T[:2, 3], top + HAND_HEIGHT]))
        for thing in grasped
        for name in cast.objects_of(thing)
        if places[name].on == TABLE
    )
