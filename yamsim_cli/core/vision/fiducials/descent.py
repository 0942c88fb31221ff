"""Robust least squares over all pixels of a print: normal equations, and Levenberg and Marquardt's way down."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np

from ...geometry.se3 import Array
from .linearize import Tile

# Residuals beyond this many standard deviations count less and less (Huber's 95 % efficiency).
_HUBER = 1.345
# The least noise (grey levels) that is believed: rounding alone makes as much.
_LEAST_NOISE = 0.3

_MAX_ITERATIONS = 30
# Steps below this no longer matter: shift of the print in the picture, px.
_CONVERGED_PX = 4e-3

Part = tuple[Array, Array, dict[int, Tile]]
S = TypeVar("S")


@dataclass(frozen=True)
class System:
    """Normal equations over all that could be varied, and what the residuals look like.

    Attributes:
        normal, gradient: (k, k) and (k,).
        cost: weighted sum of squared residuals, grey levels squared, over `pixels` pixels of the summed `weight`.
        noise: that the residuals are weighted for, or that they show; grey levels.
    """

    normal: Array
    gradient: Array
    cost: float
    weight: float
    pixels: int
    noise: float
    tiles: tuple[dict[int, Tile], ...]


class Problem(Protocol[S]):
    """What is varied, and how the photo answers."""

    @property
    def free(self) -> list[int]:
        """Places of what is varied among all parameters."""
        ...

    def system(self, state: S, noise: float | None) -> System | None:
        """Normal equations at a state; residuals weighted for a given noise, or for the noise found."""
        ...

    def moved(self, state: S, step: Array) -> S:
        """The state a step (k,) away."""
        ...

    def moved_px(self, state: S, step: Array) -> float:
        """About how far a step moves the print in the picture."""
        ...


def weighed(parts: Sequence[Part | None], noise: float | None) -> System | None:
    """Normal equations of all parts together; None where one shows nothing."""
    whole = [part for part in parts if part is not None]
    if len(whole) < len(parts):
        return None
    residual = np.concatenate([part[0] for part in whole])
    jacobian = np.concatenate([part[1] for part in whole])
    if noise is None:
        noise = float(1.4826 * np.median(np.abs(residual)))
    noise = max(noise, _LEAST_NOISE)
    weight = np.minimum(1.0, _HUBER * noise / np.maximum(np.abs(residual), 1e-9))
    weighted = jacobian * weight[:, None]
    return System(
        weighted.T @ jacobian + 1e-12 * np.eye(jacobian.shape[1]),
        weighted.T @ residual,
        float(weight @ residual**2),
        float(weight.sum()),
        len(residual),
        noise,
        tuple(part[2] for part in whole),
    )


def descend(problem: Problem[S], state: S) -> tuple[S, System] | None:
    """The best state near a first one, and the equations there; None where the fit breaks down."""
    damping, system = 1e-3, problem.system(state, noise=None)
    for _ in range(_MAX_ITERATIONS):
        if system is None:
            return None
        step = _step(problem.free, system, damping)
        moved = problem.moved_px(state, step)
        there = problem.moved(state, step)
        trial = problem.system(there, noise=system.noise)
        if trial is not None and trial.cost / trial.weight <= system.cost / system.weight:
            state, damping = there, max(damping / 8, 1e-6)
            system = replace(trial, noise=float(np.sqrt(trial.cost / max(1.0, trial.weight - 7))))
        else:
            damping *= 8
        if moved < _CONVERGED_PX or damping > 1e4:
            break
    return None if system is None else (state, system)


def _step(free: list[int], system: System, damping: float) -> Array:
    """The step (k,) that Levenberg and Marquardt take; 0 for what is not varied."""
    normal = system.normal[np.ix_(free, free)]
    step = np.zeros(len(system.gradient))
    step[free] = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), system.gradient[free])
    return step
