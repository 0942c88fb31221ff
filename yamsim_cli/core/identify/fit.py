"""The values by which an arm follows its logs best, and how surely each is known."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..geometry.least_squares import LeastSquares, descend
from ..geometry.se3 import Array
from .plant import ArmPlant, Run, Values

# A log's beginning is not compared, s: nobody knows how fast the arm was, nor which way its friction pulled.
_BEGINNING = 0.5
# As fine as anything is read at best, rad, so that no joint counts without end.
_FINEST = 1e-4
_MOST_STEPS, _MOST_AGAIN = 8, 2
# Delays that are tried first, s: from one that is far off, a descent goes astray.
_DELAYS = tuple(0.01 * k for k in range(11))
# A fit stands still when a step moves nothing by more than this share of its scale, or gains less than this share.
_STILL, _LITTLE = 0.01, 1e-3


@dataclass(frozen=True)
class Parameter:
    """One number that a fit varies.

    Attributes:
        name: of the field of `Values`.
        joint: number of the joint; None of what all have in common.
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
        return replace(values, **{parameter.name: number})
    changed = getattr(values, parameter.name).copy()
    changed[parameter.joint] = number
    return replace(values, **{parameter.name: changed})


class _Compared:
    """Logs and what becomes of them by some values: the problem there, linearized when it is asked for."""

    def __init__(self, problem: _Problem, values: Values, same: _Compared | None = None) -> None:
        self._problem, self.values = problem, values
        self.errors = same.errors if same else problem.errors(values)
        if same:
            self.slopes = same.slopes
        believed = problem.believed(values)
        self.cost = float(np.sum((self.errors * problem.weights) ** 2) + believed @ believed)

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
        weighted = self.slopes * self._problem.weights[None, :, None]
        flat = weighted.reshape(-1, weighted.shape[-1])
        return flat.T @ flat + np.diag(self._problem.precision)

    @property
    def gradient(self) -> Array:
        """Their right-hand side (k,)."""
        weighted = self.slopes * self._problem.weights[None, :, None] ** 2
        flat = weighted.reshape(-1, weighted.shape[-1])
        believed = self._problem.believed(self.values)
        return -(flat.T @ self.errors.ravel()) - np.sqrt(self._problem.precision) * believed


class _Problem(LeastSquares[Values, _Compared]):
    def __init__(
        self,
        plant: ArmPlant,
        runs: Sequence[Run],
        weights: Array,
        step: Callable[[], None],
        known: _Compared | None = None,
    ) -> None:
        self.parameters = parameters(plant)
        self.weights = weights
        self.precision = np.array([(each.scale / each.spread) ** 2 for each in self.parameters])
        self._centre = plant.values
        # Where another problem of other weights has been already, errors and slopes are its own.
        self._runs, self._step, self._known = runs, step, known

    def errors(self, values: Values) -> Array:
        """What is read less what was measured, of every compared sample of all runs (samples, dof), rad."""
        self._step()
        return np.concatenate([(run.follow(values) - run.log.joints)[compared(run)] for run in self._runs])

    def believed(self, values: Values) -> Array:
        """How far each parameter is from what was believed, in its spread (k,)."""
        return np.array([(value(values, p) - value(self._centre, p)) / p.spread for p in self.parameters])

    def linearized(self, state: Values, before: _Compared | None) -> _Compared | None:
        same = self._known if self._known is not None and self._known.values is state else None
        there = _Compared(self, state, same)
        return there if np.isfinite(there.cost) else None

    def moved(self, state: Values, step: Array) -> Values:
        for parameter, part in zip(self.parameters, step, strict=True):
            number = float(np.clip(value(state, parameter) + part * parameter.scale, parameter.least, parameter.most))
            state = with_value(state, parameter, number)
        return state

    def settled(self, state: Values, known: _Compared, step: Array, gain: Array) -> bool:
        return bool(np.abs(step).max() < _STILL or 0 <= float(gain) < _LITTLE * known.cost)


def compared(run: Run) -> Array:
    """Which samples of a run are compared (n,)."""
    return run.read & (run.log.times >= min(_BEGINNING, run.log.seconds / 10))


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
    """

    values: Values
    parameters: list[Parameter]
    errors: Array
    slopes: Array
    weights: Array
    times: Array


def fit(plant: ArmPlant, runs: Sequence[Run], step: Callable[[], None] = lambda: None) -> Fitted:
    """The values by which an arm follows runs best.

    Args:
        step: called before each time that the runs are followed.
    """
    weights = np.full(len(plant.kp), 1 / _FINEST)
    problem = _Problem(plant, runs, weights, step)
    delays = {plant.values.delay, *_DELAYS} if plant.values.delay < _DELAYS[-1] else {plant.values.delay}
    tried = [replace(plant.values, delay=delay) for delay in sorted(delays)]
    values = min(tried, key=lambda one: float(np.sum(problem.errors(one) ** 2)))
    there: _Compared | None = None
    for most in (_MOST_STEPS, _MOST_AGAIN):
        problem = _Problem(plant, runs, weights, step, there)
        found = descend(problem, values, most)
        assert found is not None, "the model itself can be simulated"
        values, there = found
        spread = np.sqrt(np.mean(there.errors**2, axis=0))
        weights = 1 / np.maximum(spread, _FINEST)
    offsets = np.concatenate([[0.0], np.cumsum([run.log.seconds + 1 for run in runs])])
    times = np.concatenate([run.log.times[compared(run)] + at for run, at in zip(runs, offsets, strict=False)])
    assert there is not None
    return Fitted(values, problem.parameters, there.errors, there.slopes, weights, times)
