"""An attempt as its task's planner makes it: planned, simulated, judged, and given its distractors."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..sim.rollout import path_actions, path_start
from ..types import Actions, Attempt, Cause, Outcome
from .distractors import with_distractors
from .physics import repeat
from .programs import demonstrate_program
from .simulated import Simulated
from .simulator import Simulator

# A plan that misses a waypoint by more than this is out of the arm's reach, m.
_REACH_TOLERANCE = 0.005


@dataclass(frozen=True)
class Planned:
    """An attempt with a plan for it.

    Attributes:
        attempt: with the plan's own start: its fingers are as wide open as the chosen hold needs.
        actions: what makes the arms follow the plan.
        position_error, tilt: of the plan's inverse kinematics, m and rad, see `JointPath`.
    """

    attempt: Attempt
    actions: Actions
    position_error: float
    tilt: float


def plan(simulator: Simulator, attempt: Attempt) -> Planned:
    """A plan for an attempt that has a layout; whether its errors are small enough is for the caller to say."""
    assert attempt.layout is not None, "there is nothing to plan without a layout"
    scene, found = simulator.scene, simulator.planner.plan(attempt.layout)
    begun = replace(attempt, start=path_start(scene, attempt.layout, found.paths))
    return Planned(begun, path_actions(scene, found.paths), found.position_error, found.tilt)


def demonstrate(simulator: Simulator, attempt: Attempt) -> Simulated:
    """What the planner makes of an attempt, in physics alone."""
    if simulator.config.program:
        done = demonstrate_program(simulator, attempt)
        return replace(done, attempt=with_distractors(simulator, done.attempt, done.states)) if done.states else done
    if attempt.layout is None:
        detail = f"no free place for the {simulator.config.pair.target.name} in the sampling box"
        return Simulated(attempt, Outcome(False, Cause.NO_LAYOUT, detail), None)

    planned = plan(simulator, attempt)
    if planned.position_error > _REACH_TOLERANCE:
        detail = (
            f"the hand ends {planned.position_error * 1000:.0f} mm from where it should be "
            f"(at most {_REACH_TOLERANCE * 1000:.0f}): out of the arm's reach"
        )
        return Simulated(attempt, _with_plan(Outcome(False, Cause.UNREACHABLE, detail), planned), None)

    done = repeat(simulator, planned.attempt, planned.actions, planned=True)
    done = replace(done, outcome=_with_plan(done.outcome, planned))
    if not done.outcome.success:
        return done
    return replace(done, attempt=with_distractors(simulator, done.attempt, done.states))


def with_room(simulator: Simulator, attempt: Attempt) -> Attempt:
    """The attempt with distractors that leave room for its demonstration, for whoever else is to act in it.

    Nothing is planned where the config has no distractors. Where the demonstration fails, there are none either.
    """
    return attempt if simulator.placer is None else demonstrate(simulator, attempt).attempt


def _with_plan(outcome: Outcome, planned: Planned) -> Outcome:
    return replace(outcome, position_error=planned.position_error, tilt=planned.tilt)
