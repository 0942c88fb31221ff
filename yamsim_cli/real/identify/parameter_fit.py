"""Fit an arm's parameters to its logs."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yamsim_cli.core.config.rig import ArmConfig
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.least_squares import LeastSquares, solve_least_squares

from .plant_model import FINE_TIMESTEP, ArmLog, LogSimulation, ParametricArm, PlantParameters

_SKIPPED_START_SECONDS = 0.5  # s of a log, in which speed and friction are unknown
_MIN_ERROR = 1e-4  # rad, of a joint's RMS error, whose inverse is its weight
_ACCELERATION_PERIOD = 0.04  # s, between positions that give an acceleration
_MAX_STEPS, _MAX_FINE_STEPS = 6, 4  # fit steps with TIMESTEP, then with FINE_TIMESTEP
_START_DELAYS = tuple(0.01 * k for k in range(11))  # s; the fit starts from the best, since a wrong delay makes it fail
# A fit ends when a step changes each parameter by less than this share of its scale, or the cost by this share.
_MIN_STEP, _MIN_GAIN = 0.01, 1e-3


@dataclass(frozen=True)
class FitParameter:
    """A parameter that the fit varies.

    Attributes:
        name: field of `PlantParameters`.
        joint: None for the delay, which all joints share.
        scale: a step that noticeably changes the motion.
        prior_sigma: of the prior, whose mean is the model's value.
    """

    name: str
    joint: int | None
    scale: float
    prior_sigma: float
    minimum: float
    maximum: float = np.inf


def all_parameters(plant: ParametricArm) -> list[FitParameter]:
    """Return the parameters to fit for an arm."""
    found = [FitParameter("delay", None, 0.005, 0.1, 0.0)]
    for k in range(len(plant.kp)):
        most, kv, armature = plant.max_torque[k], plant.kv[k], plant.model_values.armature[k]
        found += [
            FitParameter("friction", k, 0.005 * most, 0.1 * most, 0.0),
            FitParameter("damping", k, 0.2 * kv, 3 * kv, -0.9 * kv),
            FitParameter("armature", k, max(0.3 * armature, 1e-4), max(armature, 1e-3), 0.2 * armature),
            FitParameter("offset", k, 0.005, 0.1, -np.inf),
            FitParameter("friction_velocity", k, 0.004, 0.02, 5e-4, 0.2),
            FitParameter("gravity", k, 0.05, 0.3, -2.0, 4.0),
        ]
    return found


def parameter_value(values: PlantParameters, parameter: FitParameter) -> float:
    """Return a parameter's value in the unit of `PlantParameters`."""
    found = getattr(values, parameter.name)
    return float(found if parameter.joint is None else found[parameter.joint])


def replace_value(values: PlantParameters, parameter: FitParameter, number: float) -> PlantParameters:
    """Return a copy with `parameter` set to `number`."""
    if parameter.joint is None:
        return replace(values, delay=number)
    changed: Array = getattr(values, parameter.name).copy()
    changed[parameter.joint] = number
    fields: dict[str, Any] = {parameter.name: changed}
    return replace(values, **fields)


class _LinearizedFit:
    def __init__(self, problem: _ParameterProblem, values: PlantParameters) -> None:
        self._problem, self.values = problem, values
        self.errors = problem.joint_errors(values)
        self.cost = float(np.sum((self.errors * problem.weights) ** 2) + np.sum(problem.prior_residuals(values) ** 2))

    @functools.cached_property
    def error_jacobian(self) -> Array:
        """Change of errors (samples, dof, parameters) per parameter scale."""
        found = np.empty((*self.errors.shape, len(self._problem.parameters)))
        for k, parameter in enumerate(self._problem.parameters):
            moved = replace_value(self.values, parameter, parameter_value(self.values, parameter) + parameter.scale)
            found[..., k] = self._problem.joint_errors(moved) - self.errors
        return found

    @property
    def normal_matrix(self) -> Array:
        return self._problem.weighted_normal_matrix(self.error_jacobian)

    @property
    def right_hand_side(self) -> Array:
        return self._problem.weighted_right_hand_side(self.error_jacobian, self.errors, self.values)


class _ParameterProblem(LeastSquares[PlantParameters, _LinearizedFit]):
    """Find the parameters with which the simulated arm moves as in its logs.

    `weights` (dof,), 1/rad, are of the joints' errors; `step` is called before each simulation.
    """

    def __init__(
        self, plant: ParametricArm, runs: Sequence[LogSimulation], weights: Array, step: Callable[[], None]
    ) -> None:
        self.parameters = all_parameters(plant)
        self.weights = weights
        self._precision = np.array([(each.scale / each.prior_sigma) ** 2 for each in self.parameters])
        self._centre = plant.model_values
        self._runs, self._step = runs, step

    def joint_errors(self, values: PlantParameters) -> Array:
        """Return simulated minus measured joints (samples, dof), rad."""
        self._step()
        return np.concatenate([(run.simulate(values) - run.log.joints)[samples_in_fit(run)] for run in self._runs])

    def prior_residuals(self, values: PlantParameters) -> Array:
        return np.array(
            [(parameter_value(values, p) - parameter_value(self._centre, p)) / p.prior_sigma for p in self.parameters]
        )

    def weighted_normal_matrix(self, slopes: Array) -> Array:
        flat = (slopes * self.weights[None, :, None]).reshape(-1, slopes.shape[-1])
        found: Array = flat.T @ flat + np.diag(self._precision)
        return found

    def weighted_right_hand_side(self, slopes: Array, errors: Array, values: PlantParameters) -> Array:
        pulled = np.einsum("ijk,ij->k", slopes, errors * self.weights**2)
        found: Array = -pulled - np.sqrt(self._precision) * self.prior_residuals(values)
        return found

    def linearize(self, state: PlantParameters, before: _LinearizedFit | None) -> _LinearizedFit | None:
        there = _LinearizedFit(self, state)
        return there if np.isfinite(there.cost) else None

    def apply_step(self, state: PlantParameters, step: Array) -> PlantParameters:
        for parameter, part in zip(self.parameters, step, strict=True):
            number = parameter_value(state, parameter) + part * parameter.scale
            state = replace_value(state, parameter, float(np.clip(number, parameter.minimum, parameter.maximum)))
        return state

    def is_converged(self, state: PlantParameters, known: _LinearizedFit, step: Array, gain: Array) -> bool:
        return bool(np.abs(step).max() < _MIN_STEP or 0 <= float(gain) < _MIN_GAIN * known.cost)


def samples_in_fit(run: LogSimulation) -> NDArray[np.bool_]:
    """Return the mask (n,) of samples with measured joints, without the start."""
    found: NDArray[np.bool_] = run.measured_mask & (run.log.times >= min(_SKIPPED_START_SECONDS, run.log.duration / 10))
    return found


@dataclass(frozen=True)
class FitResult:
    """The result of a fit.

    Attributes:
        errors: simulated minus measured joints (samples, dof), rad.
        slopes: change of errors (samples, dof, parameters) per parameter scale.
        weights: of the joints' errors (dof,), 1/rad.
        times: (samples,), s, as if logs followed each other.
        accelerations: RMS of each joint (dof,), rad/s2.
    """

    values: PlantParameters
    parameters: list[FitParameter]
    errors: Array
    error_jacobian: Array
    weights: Array
    times: Array
    accelerations: Array


def fit_parameters(arm: ArmConfig, logs: Sequence[ArmLog], step: Callable[[], None] = lambda: None) -> FitResult:
    """Fit an arm's parameters to its logs; `step` is called before each simulation.

    `TIMESTEP`, the tasks' timestep, biases inertia and delay, so a fit with `FINE_TIMESTEP` follows, with the same
    derivatives.
    """
    plant, fine = ParametricArm(arm), ParametricArm(arm, FINE_TIMESTEP)
    runs, fine_runs = [LogSimulation(plant, log) for log in logs], [LogSimulation(fine, log) for log in logs]
    problem = _ParameterProblem(plant, runs, np.full(len(plant.kp), 1 / _MIN_ERROR), step)
    tried = [replace(plant.model_values, delay=delay) for delay in sorted({plant.model_values.delay, *_START_DELAYS})]
    first = min(tried, key=lambda one: float(np.sum(problem.joint_errors(one) ** 2)))
    found = solve_least_squares(problem, first, _MAX_STEPS)
    assert found is not None, "the model itself can be simulated"
    values, there = found
    slopes, errors = there.error_jacobian, there.errors
    for _ in range(_MAX_FINE_STEPS):
        spread = np.sqrt(np.mean(errors**2, axis=0))
        problem = _ParameterProblem(fine, fine_runs, 1 / np.maximum(spread, _MIN_ERROR), step)
        errors = problem.joint_errors(values)
        moved = np.asarray(
            np.linalg.solve(
                problem.weighted_normal_matrix(slopes), problem.weighted_right_hand_side(slopes, errors, values)
            ),
            dtype=np.float64,
        )
        if np.abs(moved).max() < _MIN_STEP:
            break
        values = problem.apply_step(values, moved)
    offsets = np.concatenate([[0.0], np.cumsum([log.duration + 1 for log in logs])])
    times = np.concatenate([run.log.times[samples_in_fit(run)] + at for run, at in zip(runs, offsets, strict=False)])
    return FitResult(values, problem.parameters, errors, slopes, problem.weights, times, _rms_accelerations(logs))


def _rms_accelerations(logs: Sequence[ArmLog]) -> Array:
    squares = []
    for log in logs:
        known = np.isfinite(log.joints).all(axis=1)
        grid = np.arange(0.0, log.duration, _ACCELERATION_PERIOD)
        places = np.column_stack([np.interp(grid, log.times[known], column[known]) for column in log.joints.T])
        squares.append(np.square(np.diff(places, 2, axis=0) / _ACCELERATION_PERIOD**2))
    found: Array = np.sqrt(np.concatenate(squares).mean(axis=0))
    return found
