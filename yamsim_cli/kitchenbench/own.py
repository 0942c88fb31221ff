"""Our own tasks as scenes: a trial's things at rest on the station's table, and our goal looked at as they move."""

from __future__ import annotations

from dataclasses import dataclass

from ..core.attempt.episodes import open_episode
from ..core.attempt.sampling import no_start, sample
from ..core.attempt.simulator import Simulator
from ..core.attempt.simulators import simulator_for
from ..core.config.program_task import ProgramTask
from ..core.episode.episode import Episode
from ..core.episode.rules import EndRule, EpisodeRules
from ..core.errors import SimulationError
from ..core.session import Session
from ..core.skills.base import Skill
from ..core.skills.program import program_of
from ..core.types import Attempt, EpisodeJob
from .scene import TICK_HZ

#: The benchmark that scenes say they are of, and the kind of their goals.
BENCHMARK = "yamsim"
GOAL_KIND = "yamsim_goal"


@dataclass(frozen=True)
class OwnRealization:
    """A trial of one of our tasks, compiled and at rest. Close its simulator when it is not needed any more.

    Attributes:
        simulator: with the compiled scene and the cast.
        attempt: with everything at rest.
    """

    simulator: Simulator
    attempt: Attempt

    @property
    def instruction(self) -> str:
        """What is said."""
        return self.attempt.phrasing or self.task.language_prompt

    @property
    def scene_id(self) -> str:
        """The task's name."""
        return self.simulator.config.task.name

    @property
    def task(self) -> ProgramTask:
        """The task."""
        return self.simulator.config.task

    def episode(self) -> Episode:
        """Return a new episode, which ends once the goal has held for its hold time."""
        return open_episode(self.simulator, self.attempt, EpisodeRules(EndRule.SUCCESS))

    def program(self) -> list[Skill]:
        """The skills that are to bring it to its goal, in order."""
        return program_of(self.task, self.simulator.cast)


def realize_own(session: Session, seed: int) -> OwnRealization:
    """The first trial of a seed, as `yamsim trials --seed SEED --n 1` has it, by the station's control ticks.

    Args:
        session: of the station and the task.

    Raises:
        SimulationError: the scene cannot be compiled, or there is no room for its things.
    """
    task = session.config.task
    steps = task.timing.physics_steps_per_tick
    timing = task.timing.model_copy(update={"timestep": 1 / (TICK_HZ * steps)})
    session = session.with_values(task=task.model_copy(update={"timing": timing}))
    job = EpisodeJob(seed, 0)
    simulator = simulator_for(session, job)
    attempt = sample(simulator, job)
    if attempt.start is None:
        simulator.close()
        raise SimulationError(f"task {task.name!r}, seed {seed}: {no_start(simulator, attempt)}")
    return OwnRealization(simulator, attempt)
