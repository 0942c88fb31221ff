"""Levenberg-Marquardt: one problem, many at once, and points without a value."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.least_squares import LeastSquares, solve_least_squares


@dataclass(frozen=True)
class Linear:
    """Linear residuals (..., 2) and their derivatives (..., 2, 2)."""

    residual: Array
    slope: Array

    @property
    def cost(self) -> Array:
        cost: Array = (self.residual**2).sum(axis=-1)
        return cost

    @property
    def normal_matrix(self) -> Array:
        normal: Array = np.swapaxes(self.slope, -1, -2) @ self.slope
        return normal

    @property
    def right_hand_side(self) -> Array:
        right_hand_side: Array = -np.einsum("...ij,...i->...j", self.slope, self.residual)
        return right_hand_side


class Valley(LeastSquares[Array, Linear]):
    """Rosenbrock's valley, with its minimum at (1, 1); no value left of `wall`."""

    def __init__(self, wall: float = -np.inf) -> None:
        self.wall = wall
        self.costs: list[Array] = []

    def linearize(self, state: Array, before: Linear | None) -> Linear | None:
        x, y = state[..., 0], state[..., 1]
        if (x < self.wall).any():
            return None
        slope = np.zeros((*state.shape, 2))
        slope[..., 0, 0], slope[..., 0, 1], slope[..., 1, 0] = -20 * x, 10.0, -1.0
        return Linear(np.stack([10 * (y - x**2), 1 - x], axis=-1), slope)

    def apply_step(self, state: Array, step: Array) -> Array:
        return state + step

    def is_converged(self, state: Array, known: Linear, step: Array, gain: Array) -> bool:
        self.costs.append(np.asarray(known.cost))
        return bool((np.abs(step) < 1e-9).all())

    def select_better(
        self, better: NDArray[np.bool_], there: tuple[Array, Linear], here: tuple[Array, Linear]
    ) -> tuple[Array, Linear]:
        if better.ndim == 0:
            return super().select_better(better, there, here)
        state = np.where(better[:, None], there[0], here[0])
        found = self.linearize(state, None)
        assert found is not None
        return state, found


def test_it_follows_a_curved_valley_and_never_climbs() -> None:
    valley = Valley()
    found = solve_least_squares(valley, np.array([-1.2, 1.0]), 100)
    assert found is not None
    assert found[0] == pytest.approx([1.0, 1.0], abs=1e-7)
    assert (np.diff(valley.costs) <= 0).all()


def test_many_at_once_end_where_each_would() -> None:
    starts = np.array([[-1.2, 1.0], [3.0, -2.0], [1.0, 1.0], [0.0, 40.0]])
    together = solve_least_squares(Valley(), starts, 200)
    assert together is not None
    for start, end in zip(starts, together[0], strict=True):
        alone = solve_least_squares(Valley(), start, 200)
        assert alone is not None
        assert end == pytest.approx(alone[0], abs=1e-6)


def test_a_step_to_undefined_residuals_is_taken_back() -> None:
    found = solve_least_squares(Valley(wall=-1.3), np.array([-1.2, 1.0]), 200)
    assert found is not None
    assert found[0] == pytest.approx([1.0, 1.0], abs=1e-6)
    assert solve_least_squares(Valley(wall=0.0), np.array([-1.2, 1.0]), 200) is None


def test_a_parameter_without_effect_keeps_its_value() -> None:
    class Flat(Valley):
        def linearize(self, state: Array, before: Linear | None) -> Linear:
            return Linear(np.array([state[0] - 2.0, 0.0]), np.array([[1.0, 0.0], [0.0, 0.0]]))

    found = solve_least_squares(Flat(), np.array([0.0, 5.0]), 50)
    assert found is not None
    assert found[0] == pytest.approx([2.0, 5.0])
