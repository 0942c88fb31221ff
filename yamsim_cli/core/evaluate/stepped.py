"""A task's trials, stepped tick by tick by whoever decides what acts: an environment, or a program of a real arm's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..attempt.expert import sides
from ..attempt.physics import repeat
from ..attempt.pictures import render
from ..attempt.planned import demonstrate, with_room
from ..attempt.sampling import sample
from ..attempt.simulator import Simulator
from ..attempt.simulators import Simulators
from ..closing import Closing
from ..config.recording import RecordConfig
from ..errors import SimulationError
from ..geometry.se3 import Array
from ..images.image import Image
from ..session import Session
from ..sim.closed_loop import ClosedLoop
from ..sim.goal_watch import GoalWatch
from ..tasks.kinds import kind_of
from ..types import Actions, Attempt, EpisodeJob, Holds, Outcome

# An object is slow just after it was let go, too. It counts as at rest after so many ticks, a quarter of a second.
_REST_TICKS = 8

# Trials that cannot begin are left out; after so many in a row, there is none.
STARTS = 20


def most_ticks(config: RecordConfig) -> int:
    """How many control ticks a trial may take: twice as many as its plan does, or as a task that is data says."""
    return config.program.most_ticks if config.program else 2 * kind_of(config.pair).ticks(config)


class SteppedTask(Closing):
    """The trials that `pickplace batch` has of the same numbers, one after the other. Close it, since it may render.

    Attributes:
        config: of the task.
        simulator: of the trial that was begun last, and of some cast's before that: casts differ in things alone.
        attempt: the trial, as it was sampled.
        loop: the trial's scene in motion.
        watch: what looks at the goal of a task that is data; None for others.
    """

    attempt: Attempt
    loop: ClosedLoop
    watch: GoalWatch | None
    _denied: bool
    _rested: int

    def __init__(self, session: Session) -> None:
        self.config = session.config
        self._simulators = Simulators(session)
        self.simulator: Simulator = self._simulators.of(EpisodeJob(self.config.seed, 0))

    def begin(self, job: EpisodeJob) -> None:
        """Begin a trial, or the next one that has a start.

        Raises:
            SimulationError: none of many has one.
        """
        for attempt in self._sampled(job):
            if attempt.layout is not None:
                self._set_up(with_room(self.simulator, attempt))
                return
        raise self._none(job, "has a start")

    def begin_demonstrated(self, job: EpisodeJob) -> Actions:
        """Begin a trial, or the next one in which the task's expert succeeds, as an episode of `record` does.

        Returns:
            What the expert does.

        Raises:
            SimulationError: it succeeds in none of many.
        """
        for attempt in self._sampled(job):
            done = demonstrate(self.simulator, attempt)
            if done.outcome.success:
                self._set_up(done.attempt)
                parts = [state.actions for state in done.states]
                ctrl, magnet, joints = zip(*((part.ctrl, part.magnet, part.joints) for part in parts), strict=True)
                return Actions(np.concatenate(ctrl), np.concatenate(magnet), np.concatenate(joints))
        raise self._none(job, "can be demonstrated")

    def step(self, ctrl: Array, holds: Sequence[bool] | Holds) -> None:
        """Let a command act for a control tick, see `ClosedLoop.step`."""
        self.loop.step(ctrl, holds)
        if self.watch is not None:
            self.watch.tick()

    def succeeded(self) -> bool:
        """Whether the trial is a success by now, judged as by the batch; ask after every tick until it is."""
        if not self._looks_done() or self._denied:
            return False
        success = self.judge().success
        # What the batch does not count as success, such as an object pushed onto the target, stays a failure.
        self._denied = not success
        return success

    def judge(self) -> Outcome:
        """How the trial would be judged if it ended now."""
        return repeat(self.simulator, self.attempt, self.loop.actions, planned=False).outcome

    def render(self, cameras: Sequence[str], qpos: Array | None = None) -> dict[str, Image]:
        """Camera -> image (height, width, 3) of the state now, or at MuJoCo's positions (nq,)."""
        return render(self.simulator, self.attempt, self.loop.data.qpos if qpos is None else qpos, cameras)

    def close(self) -> None:
        """Free the renderers."""
        self._simulators.close()

    def _sampled(self, job: EpisodeJob) -> Iterator[Attempt]:
        """The attempts from a job on, so many; each one's simulator is the one that is used from then on."""
        for number in range(job.attempt, job.attempt + STARTS):
            one = EpisodeJob(job.seed, number)
            self.simulator = self._simulators.of(one)
            yield sample(self.simulator, one)

    def _set_up(self, attempt: Attempt) -> None:
        assert attempt.start is not None, "it has a layout"
        self.attempt = attempt
        self._denied, self._rested = False, 0
        scene, config = self.simulator.varied(attempt), self.config
        carried = None if config.program else config.pair.object.name
        self.loop = ClosedLoop(scene, attempt.start, carried, config.task.timing)
        cast = self.simulator.cast
        self.watch = (
            GoalWatch(scene, self.loop.data, config.program, cast, sides(config)) if config.program and cast else None
        )

    def _looks_done(self) -> bool:
        """Whether it looks like a success, so that it is worth to be judged."""
        if self.watch is not None:
            return self.watch.reached
        loop, task = self.loop, self.config.pair
        rests = not loop.holds and loop.rests_on(task.target.name, task.success)
        self._rested = self._rested + 1 if rests else 0
        return self._rested >= _REST_TICKS

    def _none(self, job: EpisodeJob, does: str) -> SimulationError:
        return SimulationError(
            f"task {self.config.task.name!r}: none of {STARTS} trials from {job.attempt} of seed {job.seed} on {does}; "
            f"`yamsim pickplace batch --seed {job.seed}` tells why"
        )
