"""Where driven attempts take place: the scene of each one, how it begins there, and the arms in it."""

from __future__ import annotations

from dataclasses import replace

from ..attempt.expert import sides
from ..attempt.programs import no_start
from ..attempt.sampling import sample
from ..attempt.simulator import Simulator
from ..attempt.simulators import Simulators
from ..errors import SimulationError
from ..geometry.se3 import Array
from ..planning.demonstration import start_stands
from ..scene.compiled import CompiledScene
from ..session import Session
from ..sim.closed_loop import ClosedLoop
from ..sim.goal_watch import GoalWatch
from ..types import Attempt, EpisodeJob
from .driven_arm import DrivenArm


class Stage:
    """The scene of the attempt that was set up last. In a task that is data, casts have scenes of their own.

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
        attempt, task = self.again(job), self._config.task
        if attempt.layout is None:
            assert self._simulator is not None, "it was entered"
            why = (
                no_start(self._simulator, attempt)
                if self._config.program
                else "the sampling box has no room for both objects"
            )
            raise SimulationError(f"task {task.name!r}: {why}")
        if self._config.program:
            return attempt
        return replace(attempt, start=self.scene.start_qpos(attempt.layout, self.stands))

    def again(self, job: EpisodeJob, start: Array | None = None) -> Attempt:
        """The attempt of two numbers as it was sampled, or from another start: MuJoCo's positions (nq,)."""
        simulator = self._simulators.of(job)
        if simulator is not self._simulator:
            self._simulator, self.scene = simulator, simulator.scene
            self.arms = tuple(DrivenArm(simulator.config, self.scene, k) for k in range(len(self.scene.arms)))
        attempt = sample(simulator, job)
        return attempt if start is None else replace(attempt, start=start)

    def set_up(self, attempt: Attempt) -> tuple[ClosedLoop, GoalWatch | None]:
        """The scene at the start of the attempt that was begun last, at rest, and what looks at its goal if it has one.

        Distractors are placed where nothing came near once the attempt is over.
        """
        config, simulator = self._config, self._simulator
        assert attempt.start is not None and simulator is not None, "it has a layout, in this scene"
        scene = simulator.varied(attempt)
        for arm, stand in zip(self.arms, self.stands, strict=True):
            arm.reset(stand)
        carried = None if config.program else config.pair.object.name
        loop = ClosedLoop(scene, attempt.start, carried, config.task.timing)
        if config.program is None or simulator.cast is None:
            return loop, None
        return loop, GoalWatch(scene, loop.data, config.program, simulator.cast, self.sides)
