"""Our own tasks as scenes: a trial's things at rest on the station's table, and our goal looked at as they move."""

from __future__ import annotations

from dataclasses import dataclass

from ..core.attempt.expert import sides
from ..core.attempt.programs import no_start
from ..core.attempt.sampling import sample
from ..core.attempt.simulator import Simulator
from ..core.attempt.simulators import cast_for, simulator_for
from ..core.config.program_task import ProgramTask
from ..core.errors import SimulationError
from ..core.geometry.se3 import Array
from ..core.session import Session
from ..core.sim.goal_watch import GoalWatch
from ..core.sim.world import SimWorld, world_of
from ..core.skills.base import Skill
from ..core.skills.program import read_program
from ..core.types import EpisodeJob
from .motion import Motion
from .scene import TICK_HZ

#: The benchmark that scenes say they are of, and the kind of their goals.
BENCHMARK = "yamsim"
GOAL_KIND = "yamsim_goal"


@dataclass(frozen=True)
class OwnRealization:
    """A trial of one of our tasks, compiled and at rest. Close its simulator when it is not needed any more.

    Attributes:
        simulator: with the compiled scene and the cast.
        start: MuJoCo's positions (nq,) with everything at rest.
        instruction: what is said.
    """

    simulator: Simulator
    start: Array
    instruction: str

    @property
    def scene_id(self) -> str:
        """The task's name."""
        return self.simulator.config.task.name

    @property
    def task(self) -> ProgramTask:
        """The task."""
        found = self.simulator.config.program
        assert found is not None, "of tasks that are data alone"
        return found

    def world(self, motion: Motion) -> SimWorld:
        """Its state in motion, as goals and skills ask it."""
        return world_of(self.simulator.scene, motion.data, sides(self.simulator.config))

    def watch(self, motion: Motion) -> GoalWatch:
        """What looks at the goal; its `tick` is to be called after every control tick."""
        cast = self.simulator.cast
        assert cast is not None, "of tasks that are data alone"
        return GoalWatch(self.simulator.scene, motion.data, self.task, cast, sides(self.simulator.config))

    def program(self) -> list[Skill]:
        """The skills that are to bring it to its goal, in order."""
        cast = self.simulator.cast
        assert cast is not None, "of tasks that are data alone"
        return read_program(self.task.expert, cast)


def realize_own(session: Session, seed: int) -> OwnRealization:
    """The first trial of a seed, as `yamsim pickplace batch --seed SEED --n 1` has it, by the station's control ticks.

    Args:
        session: of the station and a task that is data.

    Raises:
        SimulationError: the scene cannot be compiled, or there is no room for its things.
    """
    task = session.config.program
    assert task is not None, "of tasks that are data alone"
    steps = task.timing.physics_steps_per_tick
    timing = task.timing.model_copy(update={"timestep": 1 / (TICK_HZ * steps)})
    session = session.with_values(task=task.model_copy(update={"timing": timing}))
    job = EpisodeJob(seed, 0)
    simulator = simulator_for(session, cast_for(session, job))
    attempt = sample(simulator, job)
    if attempt.start is None:
        simulator.close()
        raise SimulationError(f"task {task.name!r}, seed {seed}: {no_start(simulator, attempt)}")
    return OwnRealization(simulator, attempt.start, attempt.phrasing or task.language_prompt)
