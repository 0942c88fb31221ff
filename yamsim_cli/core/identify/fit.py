"""The values by which an arm follows its logs best, and how surely each is known."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..config.rig import ArmConfig
from ..geometry.least_squares import LeastSquares, descend
from ..geometry.se3 import Array
from .plant import FINE_TIMESTEP, ArmPlant, Log, Run, Values

# A log's beginning is not compared, s: nobody knows how fast the arm was, nor which way its friction pulled.
_BEGINNING = 0.5
# As fine as anything is read at best, rad, so that no joint counts without end.
_FINEST = 1e-4
# Accelerations are taken over so long, s.
_OVER = 0.04
_MOST_STEPS, _MOST_FINE = 6, 4
# Delays that are tried first, s: from one that is far off, a descent goes astray.
_DELAYS = tuple(0.01 * k for k in range(11))
# A fit stands still when a step moves nothing by more than this share of its scale, or gains less than this share.
_STILL, _LITTLE = 0.01, 1e-3


@dataclass(frozen=True)
class Parameter:
    """One number that a fit varies.

    Attributes:
        name: of the field of `Values`.
        joint: number of the joint; None of the delay, which all have in common.
        scale: how large a step is that changes something.
        spread: standard deviation of what is believed before any log is seen, around what the model has.
        least, most: no value is smaller or larger.
    """

    name: str
    joint: int | None
    scale: float
    spread: float
    least: float
    most: float = np.inf


def parameters(plant: ArmPlant) -> list[Parameter]:
    """All that is fitted of an arm."""
    found = [Parameter("delay", None, 0.005, 0.1, 0.0)]
    for k in range(len(plant.kp)):
        most, kv, armature = plant.most_torque[k], plant.kv[k], plant.values.armature[k]
        found += [
            Parameter("friction", k, 0.005 * most, 0.1 * most, 0.0),
            Parameter("damping", k, 0.2 * kv, 3 * kv, -0.9 * kv),
            Parameter("armature", k, max(0.3 * armature, 1e-4), max(armature, 1e-3), 0.2 * armature),
            Parameter("offset", k, 0.005, 0.1, -np.inf),
            Parameter("creep", k, 0.004, 0.02, 5e-4, 0.2),
            Parameter("gravity", k, 0.05, 0.3, -2.0, 4.0),
        ]
    return found


def value(values: Values, parameter: Parameter) -> float:
    """A parameter's value."""
    found = getattr(values, parameter.name)
    return float(found if parameter.joint is None else found[parameter.joint])


def with_value(values: Values, parameter: Parameter, number: float) -> Values:
    """The same values but for one parameter's."""
    if parameter.joint is None:
        return replace(values, delay=number)
    changed: Array = getattr(values, parameter.name).copy()
    changed[parameter.joint] = number
    fields: dict[str, Any] = {parameter.name: changed}
    return replace(values, **fields)


class _Compared:
    """Logs and what becomes of them by some values: the problem there, linearized when it is asked for."""

    def __init__(self, problem: _Problem, values: Values) -> None:
        self._problem, self.values = problem, values
        self.errors = problem.errors(values)
        self.cost = problem.cost(self.errors, values)

    @functools.cached_property
    def slopes(self) -> Array:
        """How the errors change with each parameter, in its scale (samples, dof, parameters)."""
        problem = self._problem
        found = np.empty((*self.errors.shape, len(problem.parameters)))
        for k, parameter in enumerate(problem.parameters):
            moved = with_value(self.values, parameter, value(self.values, parameter) + parameter.scale)
            found[..., k] = problem.errors(moved) - self.errors
        return found

    @property
    def normal(self) -> Array:
        """The normal equations' matrix (k, k)."""
        return self._problem.normal(self.slopes)

    @property
    def gradient(self) -> Array:
        """Their right-hand side (k,)."""
        return self._problem.gradient(self.slopes, self.errors, self.values)


class _Problem(LeastSquares[Values, _Compared]):
    """An arm that is to follow its logs, by joints that count as their `weights` (dof,) say, 1/rad."""

    def __init__(self, plant: ArmPlant, runs: Sequence[Run], weights: Array, step: Callable[[], None]) -> None:
        self.parameters = parameters(plant)
        self.weights = weights
        self._precision = np.array([(each.scale / each.spread) ** 2 for each in self.parameters])
        self._centre = plant.values
        self._runs, self._step = runs, step

    def errors(self, values: Values) -> Array:
        """What is read less what was measured, of every compared sample of all runs (samples, dof), rad."""
        self._step()
        return np.concatenate([(run.follow(values) - run.log.joints)[compared(run)] for run in self._runs])

    def cost(self, errors: Array, values: Values) -> float:
        """What is to become small."""
        return float(np.sum((errors * self.weights) ** 2) + np.sum(self._believed(values) ** 2))

    def normal(self, slopes: Array) -> Array:
        """The normal equations' matrix (k, k), for slopes (samples, dof, k)."""
        flat = (slopes * self.weights[None, :, None]).reshape(-1, slopes.shape[-1])
        found: Array = flat.T @ flat + np.diag(self._precision)
        return found

    def gradient(self, slopes: Array, errors: Array, values: Values) -> Array:
        """Their right-hand side (k,)."""
        pulled = np.einsum("ijk,ij->k", slopes, errors * self.weights**2)
        found: Array = -pulled - np.sqrt(self._precision) * self._believed(values)
        return found

    def _believed(self, values: Values) -> Array:
        """How far each parameter is from what was believed, in its spread (k,)."""
        return np.array([(value(values, p) - value(self._centre, p)) / p.spread for p in self.parameters])

    def linearized(self, state: Values, before: _Compared | None) -> _Compared | None:
        there = _Compared(self, state)
        return there if np.isfinite(there.cost) else None

    def moved(self, state: Values, step: Array) -> Values:
        for parameter, part in zip(self.parameters, step, strict=True):
            number = value(state, parameter) + part * parameter.scale
            state = with_value(state, parameter, float(np.clip(number, parameter.least, parameter.most)))
        return state

    def settled(self, state: Values, known: _Compared, step: Array, gain: Array) -> bool:
        return bool(np.abs(step).max() < _STILL or 0 <= float(gain) < _LITTLE * known.cost)


def compared(run: Run) -> NDArray[np.bool_]:
    """Which samples of a run are compared (n,)."""
    found: NDArray[np.bool_] = run.read & (run.log.times >= min(_BEGINNING, run.log.seconds / 10))
    return found


@dataclass(frozen=True)
class Fitted:
    """Values that were fitted.

    Attributes:
        values: they.
        parameters: what was varied.
        errors: what the arm reads less what was measured (samples, dof), rad.
        slopes: how these change with each parameter, in its scale (samples, dof, parameters).
        weights: of each joint (dof,), 1/rad.
        times: of the samples, each run's after the one before (samples,), s.
        accelerations: root mean square of each joint's in the logs (dof,), rad/s2.
    """

    values: Values
    parameters: list[Parameter]
    errors: Array
    slopes: Array
    weights: Array
    times: Array
    accelerations: Array


def fit(arm: ArmConfig, logs: Sequence[Log], step: Callable[[], None] = lambda: None) -> Fitted:
    """The values by which an arm follows logs best.

    What a step of physics is long enough to change shows as inertia and delay. So the arm follows by the steps of tasks
    until little is left, and then by finer ones, along the slopes that are known.

    Args:
        step: called before each time that the logs are followed.
    """
    plant, fine = ArmPlant(arm), ArmPlant(arm, FINE_TIMESTEP)
    runs, fine_runs = [Run(plant, log) for log in logs], [Run(fine, log) for log in logs]
    problem = _Problem(plant, runs, np.full(len(plant.kp), 1 / _FINEST), step)
    tried = [replace(plant.values, delay=delay) for delay in sorted({plant.values.delay, *_DELAYS})]
    first = min(tried, key=lambda one: float(np.sum(problem.errors(one) ** 2)))
    found = descend(problem, first, _MOST_STEPS)
    assert found is not None, "the model itself can be simulated"
    values, there = found
    slopes, errors = there.slopes, there.errors
    for _ in range(_MOST_FINE):
        spread = np.sqrt(np.mean(errors**2, axis=0))
        problem = _Problem(fine, fine_runs, 1 / np.maximum(spread, _FINEST), step)
        errors = problem.errors(values)
        moved = np.asarray(
            np.linalg.solve(problem.normal(slopes), problem.gradient(slopes, errors, values)), dtype=np.float64
        )
        if np.abs(moved).max() < _STILL:
            break
        values = problem.moved(values, moved)
    offsets = np.concatenate([[0.0], np.cumsum([log.seconds + 1 for log in logs])])
    times = np.concatenate([run.log.times[compared(run)] + at for run, at in zip(runs, offsets, strict=False)])
    return Fitted(values, problem.parameters, errors, slopes, problem.weights, times, _accelerations(logs))


def _accelerations(logs: Sequence[Log]) -> Array:
    """Root mean square of the joints' accelerations (dof,), rad/s2, from positions that are read in steps."""
    squares = []
    for log in logs:
        known = np.isfinite(log.joints).all(axis=1)
        grid = np.arange(0.0, log.seconds, _OVER)
        places = np.column_stack([np.interp(grid, log.times[known], column[known]) for column in log.joints.T])
        squares.append(np.square(np.diff(places, 2, axis=0) / _OVER**2))
    found: Array = np.sqrt(np.concatenate(squares).mean(axis=0))
    return found
