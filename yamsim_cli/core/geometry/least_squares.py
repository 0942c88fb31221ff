"""Least squares that are not linear, by Levenberg's and Marquardt's steps: for one problem, or for many alike at once.

A problem says how its residuals change with what is varied. Each step solves the linearized problem, damped: a step
that makes the cost smaller is taken and the next one is bolder, any other is taken back and the next one is more
careful.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from .se3 import Array

# How strongly steps are damped (a share of the normal equations' diagonal): at first, at least, and at most. A problem
# that is damped more than that stands still.
_FIRST, _LEAST, _MOST = 1e-3, 1e-6, 1e4
# How much less a step is damped after a good one, and how much more after a bad one.
_BOLDER, _CAREFUL = 1 / 8, 8.0
# Added to the diagonal, so that what nothing depends on stays where it is.
_TINY = 1e-9


class Linearized(Protocol):
    """A problem at a state; the leading dimensions (...) are those of many problems at once, () for one."""

    @property
    def cost(self) -> Array | float:
        """What is to become small (...)."""
        ...

    @property
    def normal(self) -> Array:
        """The normal equations' matrix (..., k, k)."""
        ...

    @property
    def gradient(self) -> Array:
        """Their right-hand side (..., k): undamped, the step is `solve(normal, gradient)`."""
        ...


S = TypeVar("S")
L = TypeVar("L", bound=Linearized)


class LeastSquares(ABC, Generic[S, L]):
    """What is varied, and what comes of it."""

    @abstractmethod
    def linearized(self, state: S, before: L | None) -> L | None:
        """The problem at a state, None where it cannot be told there.

        Args:
            before: the problem at the state that this one is compared with; None for the first.
        """

    @abstractmethod
    def moved(self, state: S, step: Array) -> S:
        """The state that a step (..., k) leads to."""

    @abstractmethod
    def settled(self, state: S, known: L, step: Array, gain: Array) -> bool:
        """Whether to stop.

        Args:
            state, known: where the last step left the problem.
            step: that was tried last (..., k).
            gain: how much smaller it made the cost (...); negative where it was taken back.
        """

    def better_of(self, better: NDArray[np.bool_], there: tuple[S, L], here: tuple[S, L]) -> tuple[S, L]:
        """The new state where it is `better` (...), and the old one elsewhere. This one is for a single problem."""
        return there if better else here


def descend(problem: LeastSquares[S, L], state: S, most_steps: int) -> tuple[S, L] | None:
    """The best state near a first one, and the problem there; None where it cannot be told at the first."""
    known = problem.linearized(state, None)
    if known is None:
        return None
    damping = np.full(np.shape(known.cost), _FIRST)
    for _ in range(most_steps):
        step = _damped_step(known.normal, known.gradient, damping)
        there = problem.moved(state, step)
        trial = problem.linearized(there, known)
        gain = np.asarray(-np.inf if trial is None else np.subtract(known.cost, trial.cost))
        better = gain > 0
        if trial is not None:
            state, known = problem.better_of(better, (there, trial), (state, known))
        damping = np.where(better, np.maximum(damping * _BOLDER, _LEAST), damping * _CAREFUL)
        if problem.settled(state, known, step, gain) or (damping > _MOST).all():
            break
    return state, known


def _damped_step(normal: Array, gradient: Array, damping: Array) -> Array:
    diagonal = np.einsum("...ii->...i", normal) + _TINY
    damped = normal + damping[..., None, None] * np.eye(normal.shape[-1]) * diagonal[..., None, :]
    step = np.linalg.solve(damped, gradient[..., None])[..., 0]
    return np.nan_to_num(step, posinf=0.0, neginf=0.0)
