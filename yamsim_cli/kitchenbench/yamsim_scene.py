from __future__ import annotations

from dataclasses import dataclass

from ..core.attempt_data import Attempt, AttemptJob
from ..core.config.program_task import ProgramTask
from ..core.config.session import Session
from ..core.episode.episode import Episode
from ..core.episode.episode_rules import EndRule, EpisodeRules
from ..core.episode.sampling import describe_missing_start, sample_attempt
from ..core.episode.simulator import Simulator, make_simulator, open_episode
from ..core.errors import SimulationError
from ..core.expert.skills.program import build_program
from ..core.expert.skills.skill import Skill
from .benchmark_scene import TICK_HZ

#: In the metadata of scenes of yamsim tasks: the name of the benchmark, and the kind of goals.
BENCHMARK = "yamsim"
TASK_GOAL_KIND = "yamsim_goal"


@dataclass(frozen=True)
class YamsimTaskScene:
    """A trial of a yamsim task, compiled and at rest. Close its simulator after use."""

    simulator: Simulator
    attempt: Attempt

    @property
    def instruction(self) -> str:
        """The trial's instruction."""
        return self.attempt.phrasing or self.task.language_prompt

    @property
    def scene_id(self) -> str:
        """The task's name."""
        return self.simulator.config.task.name

    @property
    def task(self) -> ProgramTask:
        """The task."""
        return self.simulator.config.task

    def new_episode(self) -> Episode:
        """Return a new episode, which ends once the goal has held for its hold time."""
        return open_episode(self.simulator, self.attempt, EpisodeRules(EndRule.SUCCESS))

    def expert_skills(self) -> list[Skill]:
        """Return the expert's skills, in order."""
        return build_program(self.task, self.simulator.roles)


def build_task_scene(session: Session, seed: int) -> YamsimTaskScene:
    """Build the first trial of a seed, as in `yamsim trials --seed SEED --n 1`, with the station's control ticks."""
    task = session.config.task
    steps = task.timing.physics_steps_per_tick
    timing = task.timing.model_copy(update={"timestep": 1 / (TICK_HZ * steps)})
    session = session.with_values(task=task.model_copy(update={"timing": timing}))
    job = AttemptJob(seed, 0)
    simulator = make_simulator(session, job)
    attempt = sample_attempt(simulator, job)
    if attempt.start is None:
        simulator.close()
        raise SimulationError(f"task {task.name!r}, seed {seed}: {describe_missing_start(simulator, attempt)}")
    return YamsimTaskScene(simulator, attempt)
