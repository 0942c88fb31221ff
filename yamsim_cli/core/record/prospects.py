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

from ..config.recording import RecordConfig
from ..dataset.records import AttemptRecord
from ..errors import PartialJobError, SimulationError, YamsimError
from ..geometry.se3 import Array, pose
from ..planning.ik import IkSolver
from ..scene.robot import bare_arm
from ..session import Session
from ..tasks.kinds import sample_layout
from ..tasks.plans import grasp_points
from ..tasks.resting import resting_height
from ..types import Cause, EpisodeJob, Layout

# Attempts that failed in one way, from the first one on, after which it is asked whether any could do better.
SAME = 10
# How many more starts are looked at then.
MORE_STARTS = 100
# Attempts after which a task counts as one that cannot work if none succeeded; no task is given fewer.
HOPELESS = 100
# A task that fails this often will not be finished by trying on.
_ATTEMPTS_PER_EPISODE = 20

# As for plans, see `attempt.planned`.
_REACH_TOLERANCE = 0.005
_ITERATIONS = 100

# Cause -> what of a task to look at.
_LOOK_AT: Mapping[str, str] = {
    Cause.NO_LAYOUT: "`sampling` (its box, min_separation and clearance), and how large both things are",
    Cause.UNREACHABLE: "`sampling`, `heights`, and where the rig's arm stands",
    Cause.KNOCKED: "`start_joints`, `heights.approach`, and the object's `grasp`",
    Cause.SLIPPED: "the object's `grasp.friction` and mass, and `timing`",
    Cause.DROPPED: "the object's `grasp`, `heights.release`, and the target's `collision`",
    Cause.COLLIDED: "`heights`, `start_joints`, and the target's `collision`",
    Cause.LIMITS: "`timing` (more ticks_per_waypoint), `heights`, and `start_joints`",
    Cause.OFF_TARGET: "`success`, `heights.release`, and both things' `collision` and `contact`",
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
    """Whether none of the `MORE_STARTS` attempts from number `first` on could do better than to fail for a cause; False
    for a cause, or a task, of which that can only be told by making them.
    """
    config = session.config
    if config.program:
        return False
    possible: Callable[[Layout | None], bool]
    if cause is Cause.NO_LAYOUT:
        possible = _has_room
    elif cause is Cause.UNREACHABLE:
        possible = Reach(session).holds
    else:
        return False
    numbers = range(first, first + MORE_STARTS)
    return not any(possible(sample_layout(config, EpisodeJob(config.seed, number))) for number in numbers)


def _has_room(layout: Layout | None) -> bool:
    return layout is not None


class Reach:
    """Whether hands get to where the object lies and to where it is to be put, turned in whatever way they like.

    That is less than a plan needs: where it fails, every plan does.
    """

    def __init__(self, session: Session) -> None:
        config, task = session.config, session.config.pair
        self._task = task
        self._starts = (np.array(config.start_joints), np.array(config.acting_arms[0].robot.home))
        self._picking, self._placing = (
            IkSolver(bare_arm(config.rig.arms[k]), config.rig.T_base_in_world(k))
            for k in (config.acting[0], config.acting[-1])
        )
        # The hand is so near to the object's origin, however the two are turned.
        self._slack = max(float(np.linalg.norm(point.position)) for point in grasp_points(task, config.grasp))

    def holds(self, layout: Layout | None) -> bool:
        """Whether both are in reach in a layout."""
        if layout is None:
            return False
        task = self._task
        taken, target = (layout.T_in_world[item.name][:3, 3] for item in (task.object, task.target))
        over = resting_height(task.object, task.target) + task.heights.release
        put = target + np.array([0.0, 0.0, over])
        return self._reaches(self._picking, taken) and self._reaches(self._placing, put)

    def _reaches(self, ik: IkSolver, place: Array) -> bool:
        ik.hold(np.eye(4))
        for start in self._starts:
            joints, rotation = start, np.diag([1.0, -1.0, -1.0])
            # Each time the hand is asked to be turned as it came to be: in the end, its place alone decides.
            for _ in range(3):
                solution = ik.solve(pose(place, rotation), joints, _ITERATIONS)
                if solution.position_error <= _REACH_TOLERANCE + self._slack:
                    return True
                joints = solution.joints
                rotation = ik.pose_of(joints)[:3, :3]
        return False
