"""Robust least squares over all pixels of a print: its normal equations, and when its pose no longer moves."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from ....geometry.least_squares import LeastSquares, descend
from ....geometry.se3 import Array
from .linearize import Tile

# Residuals beyond this many standard deviations count less and less (Huber's 95 % efficiency).
_HUBER = 1.345
# The least noise (grey levels) that is believed: rounding alone makes as much.
_LEAST_NOISE = 0.3

_MOST_STEPS = 30
# Steps below this no longer matter: shift of the print in the picture, px, or standard deviations of what noise leaves
# open. And where only the misfit is asked for; there, a step below the last of these is not tried smaller.
_CONVERGED, _NEARLY = (4e-3, 0.1), (2e-2, 0.4)
_NOT_WORTH_A_TRY = 1.0

Part = tuple[Array, Array, dict[int, Tile]]
S = TypeVar("S")


@dataclass(frozen=True)
class System:
    """Normal equations over all that could be varied, and what the residuals look like.

    Attributes:
        every_normal, every_gradient: (k, k) and (k,), by everything that could be varied.
        misfit: weighted sum of squared residuals, grey levels squared, over `pixels` pixels of the summed `weight`.
        noise: that the residuals are weighted for, or that they show; grey levels.
        free: places of what is varied among all parameters.
    """

    every_normal: Array
    every_gradient: Array
    misfit: float
    weight: float
    pixels: int
    noise: float
    tiles: tuple[dict[int, Tile], ...]
    free: tuple[int, ...]

    @property
    def normal(self) -> Array:
        """Normal equations (f, f) of what is varied."""
        return self.every_normal[np.ix_(self.free, self.free)]

    @property
    def gradient(self) -> Array:
        """Their right-hand side (f,)."""
        return self.every_gradient[list(self.free)]

    @property
    def cost(self) -> float:
        """The weighted mean of squared residuals: a pose that shows fewer pixels is no better for it."""
        return self.misfit / self.weight


class PrintProblem(LeastSquares[S, System]):
    """Where a print lies, and how the photo answers; `roughly` where only how well it explains that is asked for."""

    def __init__(self, roughly: bool = False) -> None:
        self._roughly = roughly

    @abstractmethod
    def system(self, state: S, noise: float | None) -> System | None:
        """Normal equations at a state; residuals weighted for a given noise, or for the noise found."""

    @abstractmethod
    def moved_px(self, state: S, step: Array) -> float:
        """About how far a step (f,) moves the print in the picture."""

    def linearized(self, state: S, before: System | None) -> System | None:
        """The system at a state, weighted for the noise known before."""
        if before is None:
            return self.system(state, None)
        found = self.system(state, before.noise)
        if found is None:
            return None
        # Weights are made anew only with the next state: within a step, both costs are weighted alike.
        return replace(found, noise=float(np.sqrt(found.misfit / max(1.0, found.weight - 7))))

    def settled(self, state: S, known: System, step: Array, gain: Array) -> bool:
        """Whether the last step hardly moved the print."""
        px, sigmas = _NEARLY if self._roughly else _CONVERGED
        of_noise = math.sqrt(max(float(step @ known.normal @ step), 0.0)) / max(known.noise, _LEAST_NOISE)
        if self._roughly and gain < 0 and of_noise < _NOT_WORTH_A_TRY:
            return True
        return of_noise < sigmas or self.moved_px(state, step) < px

    def solve(self, start: S) -> tuple[S, System] | None:
        """The best state near a first one, and the equations there; None where the photo does not show it."""
        return descend(self, start, _MOST_STEPS)


def weighed(parts: Sequence[Part | None], noise: float | None, free: tuple[int, ...]) -> System | None:
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
        free,
    )
