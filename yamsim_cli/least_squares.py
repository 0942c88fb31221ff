"""Nonlinear least squares by the Levenberg-Marquardt method, for one problem or for a batch of equal shape."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from .core.geometry.se3 import Array

# Shares of the normal matrix's diagonal: at the start, the least, and the limit for stopping.
_START_DAMPING, _MIN_DAMPING, _MAX_DAMPING = 1e-3, 1e-6, 1e4
_SHRINK, _GROW = 1 / 8, 8.0  # of the damping after an accepted and after a rejected step
_REGULARIZATION = 1e-9  # added to the diagonal; variables without influence then keep their values


class Linearized(Protocol):
    """A problem, linearized at a state. The leading dimensions (...) count problems of a batch; () for one problem."""

    @property
    def cost(self) -> Array | float:
        """Cost to be minimized (...)."""

    @property
    def normal_matrix(self) -> Array:
        """Matrix (..., k, k) of the normal equations."""

    @property
    def right_hand_side(self) -> Array:
        """Right-hand side (..., k) of the normal equations: half the cost's gradient, negative."""


S = TypeVar("S")
L = TypeVar("L", bound=Linearized)


class LeastSquares(ABC, Generic[S, L]):
    """A least-squares problem over states of type S."""

    @abstractmethod
    def linearize(self, state: S, before: L | None) -> L | None:
        """Linearize at `state`; None if undefined there. `before` is the result at the last accepted state."""

    @abstractmethod
    def apply_step(self, state: S, step: Array) -> S:
        """Return the state after a step (..., k)."""

    @abstractmethod
    def is_converged(self, state: S, known: L, step: Array, gain: Array) -> bool:
        """Return whether to stop.

        Args:
            state, known: the last accepted state, and the problem there.
            step: the last step (..., k), accepted or not.
            gain: reduction of the cost by that step (...); not positive where the step was rejected.
        """

    def select_better(self, better: NDArray[np.bool_], there: tuple[S, L], here: tuple[S, L]) -> tuple[S, L]:
        """Return `there` (state and problem after a step) if `better`, else `here`. A batch overrides this method."""
        return there if better else here


def solve_least_squares(problem: LeastSquares[S, L], state: S, max_steps: int) -> tuple[S, L] | None:
    """Return the best state within `max_steps`, and its linearized problem; None if undefined at the start."""
    known = problem.linearize(state, None)
    if known is None:
        return None
    damping = np.full(np.shape(known.cost), _START_DAMPING)
    for _ in range(max_steps):
        step = _damped_step(known.normal_matrix, known.right_hand_side, damping)
        there = problem.apply_step(state, step)
        trial = problem.linearize(there, known)
        gain = np.asarray(-np.inf if trial is None else np.subtract(known.cost, trial.cost))
        better = gain > 0
        if trial is not None:
            state, known = problem.select_better(better, (there, trial), (state, known))
        damping = np.where(better, np.maximum(damping * _SHRINK, _MIN_DAMPING), damping * _GROW)
        if problem.is_converged(state, known, step, gain) or (damping > _MAX_DAMPING).all():
            break
    return state, known


def _damped_step(normal: Array, right_hand_side: Array, damping: Array) -> Array:
    diagonal = np.einsum("...ii->...i", normal) + _REGULARIZATION
    damped = normal + damping[..., None, None] * np.eye(normal.shape[-1]) * diagonal[..., None, :]
    step = np.linalg.solve(damped, right_hand_side[..., None])[..., 0]
    return np.nan_to_num(step, posinf=0.0, neginf=0.0)
