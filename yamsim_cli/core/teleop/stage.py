"""Where driven attempts take place: the scene of each one, how it begins there, and the arms in it."""

from __future__ import annotations

from dataclasses import replace

from ..attempt.engine import Simulated, outcome_of
from ..attempt.episodes import open_episode
from ..attempt.expert import sides
from ..attempt.sampling import no_start, sample
from ..attempt.simulator import Simulator
from ..attempt.simulators import Simulators
from ..episode.episode import Episode
from ..episode.rules import EpisodeRules
from ..errors import SimulationError
from ..geometry.se3 import Array
from ..planning.arm_tools import start_stands
from ..scene.compiled import CompiledScene
from ..session import Session
from ..types import Attempt, EpisodeJob
from .driven_arm import DrivenArm


class Stage:
    """The scene of the attempt that was set up last. Every cast of things has a scene of its own.

    Attributes:
        sides: of the arms, in the order of recordings.
        stands: where they stand at the start.
        scene: compiled.
        arms: of the scene.
    """

    scene: CompiledScene
    arms: tuple[DrivenArm, ...]

    def __init__(self, session: Session) -> None:
        self._config = session.config
        self._simulators = Simulators(session)
        self._simulator: Simulator | None = None
        self.sides = sides(session.config)
        self.stands = start_stands(session.config)

    def begin(self, job: EpisodeJob) -> Attempt:
        """The attempt of two numbers, at rest at its layout with open fingers.

        Raises:
            SimulationError: its things have no room.
        """
        attempt = self.again(job)
        if attempt.start is None:
            assert self._simulator is not None, "it was entered"
            raise SimulationError(f"task {self._config.task.name!r}: {no_start(self._simulator, attempt)}")
        return attempt

    def again(self, job: EpisodeJob, start: Array | None = None) -> Attempt:
        """The attempt of two numbers as it was sampled, or from another start: MuJoCo's positions (nq,)."""
        simulator = self._simulators.of(job)
        if simulator is not self._simulator:
            self._simulator, self.scene = simulator, simulator.scene
            self.arms = tuple(DrivenArm(simulator.config, self.scene, k) for k in range(len(self.scene.arms)))
        attempt = sample(simulator, job)
        return attempt if start is None else replace(attempt, start=start)

    def set_up(self, attempt: Attempt, rules: EpisodeRules) -> Episode:
        """Return the episode of the attempt that was begun last, at its start.

        Distractors are placed where nothing came near once the attempt is over.
        """
        assert self._simulator is not None, "it was entered"
        for arm, stand in zip(self.arms, self.stands, strict=True):
            arm.reset(stand)
        return open_episode(self._simulator, attempt, rules)

    def result(self, attempt: Attempt, episode: Episode) -> Simulated:
        """End an attempt's episode, and return what became of it."""
        assert self._simulator is not None, "it was entered"
        played = episode.finish()
        return Simulated(attempt, outcome_of(self._simulator, played), played)
