"""When a recording gives up: its task cannot work, or works too rarely.

That ten attempts fail in the same way says little by itself: a task that works one time in five begins so in one
recording of nine, also where things lie out of reach, since where they lie is random. So where geometry alone decides
on the cause, the starts of a hundred more attempts are looked at, without any physics. A task that works one time in
five is then taken for hopeless in one recording of 4e10 (0.8 ** 110), one that works one time in ten in one of 1e5.
What physics decides is believed after a hundred attempts without any success: one recording of 5e9, and one of 4e4.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ..attempt.sampling import sampled_places
from ..attempt.simulators import Simulators
from ..config.recording import RecordConfig
from ..dataset.records import AttemptRecord
from ..errors import PartialJobError, SimulationError, YamsimError
from ..goals.world import TABLE
from ..session import Session
from ..skills.program import program_of
from ..types import Cause, EpisodeJob

# Attempts that failed in one way, from the first one on, after which it is asked whether any could do better.
SAME = 10
# How many more starts are looked at then.
MORE_STARTS = 100
# Attempts after which a task counts as one that cannot work if none succeeded; no task is given fewer.
HOPELESS = 100
# A task that fails this often will not be finished by trying on.
_ATTEMPTS_PER_EPISODE = 20

HAND_HEIGHT = 0.05  # m over the table, at which hands take things

# Cause -> what of a task to look at.
_LOOK_AT: Mapping[str, str] = {
    Cause.NO_LAYOUT: "`starts` (their regions and `apart`), and how large the things are",
    Cause.UNREACHABLE: "`starts`, the steps of `expert`, and where the rig's arms stand",
    Cause.SLIPPED: "the object's `grasp.friction` and mass",
    Cause.DROPPED: "the object's `grasp`, and what it is put on",
    Cause.COLLIDED: "`start_joints`, and the things' `collision`",
    Cause.LIMITS: "`starts`, and `start_joints`",
    Cause.OFF_TARGET: "the radius in `goal`, and both things' `collision` and `contact`",
    Cause.UNSTABLE: "`timing` (timestep, settle_ticks), `start_joints`, and the objects' masses and inertias",
    Cause.GOAL: "`goal`, and the steps of `expert` that are to bring it about",
    Cause.TIME: "`time_limit_s`, and how many steps `expert` has",
    Cause.WORKER_LOST: "the machine, by `yamsim doctor`",
}


class GaveUpError(PartialJobError):
    """The task works too rarely; what was recorded is whole, and to go on would not help."""


# Whether no attempt from a number on could do better than to fail for a cause.
Hopeless = Callable[[Cause, int], bool]


class Patience:
    """Decides from the attempts alone, in their order: how many workers made them makes no difference."""

    def __init__(self, config: RecordConfig, hopeless: Hopeless) -> None:
        self._name, self._wanted = config.task.name, config.episodes
        self._hopeless = hopeless
        self._asked = False

    @property
    def most_attempts(self) -> int:
        """How many attempts are made at most."""
        return max(HOPELESS, _ATTEMPTS_PER_EPISODE * self._wanted)

    def ended_by(self, attempts: Sequence[AttemptRecord], episodes: int) -> YamsimError | None:
        """Why no more attempts are to be made, after these; None if it is worth it.

        Args:
            episodes: how many of them succeeded.
        """
        tried, last = len(attempts), attempts[-1].outcome if attempts else None
        if last is None or (episodes and tried < self.most_attempts):
            return None
        if episodes:
            rest = f"the task works too rarely, {episodes} of {tried} times and at least 1 in {_ATTEMPTS_PER_EPISODE} "
            return GaveUpError(f"gave up after {tried} attempts: {rest}is needed; {self._causes(attempts)}")
        if tried >= HOPELESS:
            return self._cannot_work(f"none of {tried} attempts succeeded", attempts)
        causes = {attempt.outcome.cause for attempt in attempts}
        if tried < SAME or len(causes) > 1 or self._asked:
            return None
        self._asked = True
        if not self._hopeless(Cause(str(last.cause)), tried):
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
        """What went wrong how often, the last of the commonest in full, and what to look at."""
        failed = [attempt for attempt in attempts if not attempt.outcome.success]
        counts = Counter(str(attempt.outcome.cause) for attempt in failed).most_common()
        commonest = counts[0][0]
        detail = next(one.outcome.detail for one in reversed(failed) if one.outcome.cause == commonest)
        told = ", ".join(f"{count} {cause}" for cause, count in counts)
        advice = _LOOK_AT.get(commonest)
        return f"{told} ({detail})" + (f"; look at {advice}" if advice else "")


def hopeless(session: Session, cause: Cause, first: int) -> bool:
    """Return whether none of `MORE_STARTS` attempts from number `first` on could do better than to fail for a cause.

    False for causes of which that can only be said by making the attempts.
    """
    if cause not in (Cause.NO_LAYOUT, Cause.UNREACHABLE):
        return False
    with Simulators(session.without_meshes()) as simulators:
        return not any(
            _could_work(simulators, cause, EpisodeJob(session.config.seed, number))
            for number in range(first, first + MORE_STARTS)
        )


def _could_work(simulators: Simulators, cause: Cause, job: EpisodeJob) -> bool:
    """Return whether an attempt's things have room, and for `UNREACHABLE` also whether hands get to all that is taken.

    That is less than a program needs: where it fails, every program does.
    """
    simulator = simulators.of(job)
    places = sampled_places(simulator, job)
    if isinstance(places, str) or cause is Cause.NO_LAYOUT:
        return not isinstance(places, str)
    task, cast = simulator.config.task, simulator.cast
    taken = {thing for skill in program_of(task, cast) if skill.NEEDS is False for _, thing in skill.roles()[:1]}
    top = simulator.config.table.top
    return all(
        simulator.expert_tools.reaches_place(np.array([*places[name].T[:2, 3], top + HAND_HEIGHT]))
        for thing in taken
        for name in cast.of(thing)
        if places[name].on == TABLE
    )
