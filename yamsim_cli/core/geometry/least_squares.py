"""Nonlinear least squares by Levenberg-Marquardt steps, for one problem or for many problems of one shape at once.

Each step solves the damped, linearized problem. A step that reduces the cost is kept and the damping shrinks; any other
step is undone and the damping grows.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from .se3 import Array

# Damping as a share of the normal equations' diagonal: the first, the least, and the limit at which a problem stops.
_FIRST, _LEAST, _MOST = 1e-3, 1e-6, 1e4
_SHRINK, _GROW = 1 / 8, 8.0  # factors of the damping after a kept and after an undone step
_TINY = 1e-9  # added to the diagonal, so that variables without influence keep their value


class Linearized(Protocol):
    """A problem at a state; the leading dimensions (...) are those of many problems, or () of one."""

    @property
    def cost(self) -> Array | float:
        """The cost to be minimized (...)."""
        ...

    @property
    def normal(self) -> Array:
        """The matrix (..., k, k) of the normal equations."""
        ...

    @property
    def gradient(self) -> Array:
        """The right-hand side (..., k): the undamped step is `solve(normal, gradient)`."""
        ...


S = TypeVar("S")
L = TypeVar("L", bound=Linearized)


class LeastSquares(ABC, Generic[S, L]):
    """A least-squares problem over states of type S."""

    @abstractmethod
    def linearize(self, state: S, before: L | None) -> L | None:
        """The linearized problem at a state, or None where the problem is undefined there.

        Args:
            before: the problem at the state that `state` is compared with; None at the first state.
        """

    @abstractmethod
    def apply_step(self, state: S, step: Array) -> S:
        """The state that a step (..., k) leads to."""

    @abstractmethod
    def is_converged(self, state: S, known: L, step: Array, gain: Array) -> bool:
        """Whether to stop.

        Args:
            state, known: the state after the last step, and the problem there.
            step: the last step tried (..., k).
            gain: reduction of the cost by that step (...); negative where the step was undone.
        """

    def select_better(self, better: NDArray[np.bool_], there: tuple[S, L], here: tuple[S, L]) -> tuple[S, L]:
        """The new state where it is `better` (...), else the old one. Override this method for many problems."""
        return there if better else here


def solve_least_squares(problem: LeastSquares[S, L], state: S, most_steps: int) -> tuple[S, L] | None:
    """The best state found from a first one, and the problem there; None if the problem is undefined at the first."""
    known = problem.linearize(state, None)
    if known is None:
        return None
    damping = np.full(np.shape(known.cost), _FIRST)
    for _ in range(most_steps):
        step = _damped_step(known.normal, known.gradient, damping)
        there = problem.apply_step(state, step)
        trial = problem.linearize(there, known)
        gain = np.asarray(-np.inf if trial is None else np.subtract(known.cost, trial.cost))
        better = gain > 0
        if trial is not None:
            state, known = problem.select_better(better, (there, trial), (state, known))
        damping = np.where(better, np.maximum(damping * _SHRINK, _LEAST), damping * _GROW)
        if problem.is_converged(state, known, step, gain) or (damping > _MOST).all():
            break
    return state, known


def _damped_step(normal: Array, gradient: Array, damping: Array) -> Array:
    diagonal = np.einsum("...ii->...i", normal) + _TINY
    damped = normal + damping[..., None, None] * np.eye(normal.shape[-1]) * diagonal[..., None, :]
    step = np.linalg.solve(damped, gradient[..., None])[..., 0]
    return np.nan_to_num(step, posinf=0.0, neginf=0.0)
