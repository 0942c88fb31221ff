"""What becomes of an attempt in physics: simulated, and judged."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco

from ..sim.rollout import Rollout
from ..sim.rollout import simulate as run
from ..tasks.pickplace import Poses
from ..tasks.plans import phases_of
from ..types import Actions, Attempt, Outcome, Phases
from .programs import repeat_program
from .simulated import Simulated
from .simulator import Simulator


def simulate(
    simulator: Simulator,
    attempt: Attempt,
    actions: Actions,
    phases: Sequence[Phases],
    see: Callable[[mujoco.MjData], None] | None = None,
) -> Rollout:
    """Let actions act from an attempt's start, in its varied scene; the same inputs give the same bits on one machine.

    Args:
        phases: when the object is to be in hand, and in whose.
        see: see `sim.rollout.simulate`.
    """
    task = simulator.config.pair
    assert attempt.start is not None, "nothing moves without a layout"
    return run(simulator.varied(attempt), attempt.start, actions, task.object.name, task.timing, phases, see)


def judge(simulator: Simulator, rollout: Rollout, *, planned: bool) -> Outcome:
    """How an attempt ended, by what was seen of it, without what a plan says of itself.

    Args:
        planned: whether its actions came from a plan; then they may touch nothing, and keep to all limits.
    """
    task, grasp = simulator.config.pair, simulator.config.grasp
    item, target = task.object.name, task.target.name
    poses = Poses(
        rollout.T_at_start[item], rollout.T_object_before_grasp, rollout.T_in_world[item], rollout.T_in_world[target]
    )
    return simulator.kind.judge(task, grasp, poses, rollout.object_speed, rollout.motion, planned=planned)


def repeat(
    simulator: Simulator,
    attempt: Attempt,
    actions: Actions,
    *,
    planned: bool,
    see: Callable[[mujoco.MjData], None] | None = None,
) -> Simulated:
    """Let actions act that are known already, recorded ones or a policy's, and judge them; nothing is planned.

    Args:
        planned: whether they came from a plan, which says when the object is in hand; otherwise the weld says so. See
            `judge`, too.
        see: see `sim.rollout.simulate`.
    """
    if simulator.config.program:
        return repeat_program(simulator, attempt, actions, planned=planned, see=see)
    phases = simulator.kind.phases(simulator.config) if planned else phases_of(actions.magnet)
    rollout = simulate(simulator, attempt, actions, phases, see)
    return Simulated(attempt, judge(simulator, rollout, planned=planned), rollout)
