"""Looks at a task's goal while whoever else steps its scene."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco

from ..config.program_task import ProgramTask
from ..goals.cast import Cast
from ..goals.goal import Verdict, judge
from ..scene.compiled import CompiledScene
from .world import world_of


class GoalWatch:
    """How a goal stands in a scene that is stepped tick by tick; call `tick` after each one.

    Attributes:
        verdict: whether the goal holds now, with all its margins.
        held_ticks: for how many ticks it has held without a break.

    Args:
        data: MuJoCo's state, at rest at an attempt's start. Contacts and centres of mass are brought up to date in it.
        sides: of the scene's arms.
    """

    def __init__(
        self, scene: CompiledScene, data: mujoco.MjData, task: ProgramTask, cast: Cast, sides: Sequence[str]
    ) -> None:
        self._model, self._data, self._task, self._cast = scene.model, data, task, cast
        self._world = world_of(scene, data, sides)
        self._world.begin()
        self.verdict: Verdict = judge(task.goal, self._world, cast)
        self.held_ticks = 0

    @property
    def reached(self) -> bool:
        """Whether the goal has held for as long as the task asks."""
        return self.verdict.reached and self.held_ticks >= self._task.hold_ticks

    @property
    def told(self) -> str:
        """How it stands, for a person."""
        worst, task = self.verdict.worst, self._task
        if not worst.holds:
            return f"not yet: {worst.what}" + (f" ({worst.detail})" if worst.detail else "")
        left = (task.hold_ticks - self.held_ticks) * task.timing.tick
        return "the goal holds" + (f", and has to for {left:.1f} s more" if left > 0 else "")

    def tick(self) -> None:
        """Look at the state after a control tick."""
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_collision(self._model, self._data)
        self._world.watch()
        held = self.verdict.reached
        self.verdict = judge(self._task.goal, self._world, self._cast)
        self.held_ticks = self.held_ticks + 1 if held and self.verdict.reached else 0
