"""A fin-ray finger as a plane frame: walls and ribs as rigidly joined elastic beams; independent of the chain model."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import numpy as np

from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.robots.finray.finger import FinRay, hinge_stiffness, slip_jacobian, slip_stiffness

# Beams between two joints.
_PARTS = 6
# Thickness of a solid part, in walls.
_SOLID = 10


class PlaneFrame:
    """Small deflections of a finger by first-order theory of elastic frames.

    Each beam stretches, and bends by Euler-Bernoulli theory. The base is clamped; the tip is solid. Coordinates are x
    to the tip and y to the pushed side, from the middle of the front wall's base.
    """

    def __init__(self, finger: FinRay) -> None:
        self._points: dict[tuple[float, float], int] = {}
        self._modulus, self._width = finger.youngs_modulus, finger.width
        beams: list[tuple[int, int, float]] = []
        heights = [*finger.hinge_heights, finger.length]
        front, back = ([(x, y(x)) for x in heights] for y in (lambda x: 0.0, lambda x: -float(finger.wall_spacing(x))))
        for wall in (front, back):
            for start, end in pairwise(wall):
                beams += self._beam(start, end, finger.wall_thickness, _PARTS)
        for start, end in zip(front[1:-1], back[1:-1], strict=True):
            beams += self._beam(start, end, finger.rib_thickness, 2)
        beams += self._beam(front[-1], back[-1], _SOLID * finger.wall_thickness, 1)
        self._at = np.array(list(self._points))
        self._stiffness = self._assemble(beams)

    def pushed(self, height: float, force: float) -> tuple[float, float, float]:
        """Push the front wall in at a height (m) with a force (N).

        Returns:
            Deflections of the wall there and of the tip, m; and the tip's rotation towards the force, rad.
        """
        node = int(np.argmin(np.hypot(self._at[:, 0] - height, self._at[:, 1])))
        assert abs(self._at[node, 0] - height) < 1e-9, "a beam has to end there"
        load = np.zeros(3 * len(self._at))
        load[3 * node + 1] = -force
        free = np.repeat(self._at[:, 0] > 1e-9, 3)
        moved = np.zeros_like(load)
        moved[free] = np.linalg.solve(self._stiffness[np.ix_(free, free)], load[free])
        tip = int(np.argmax(self._at[:, 0] - 1e3 * (self._at[:, 1] < -1e-9)))
        return -moved[3 * node + 1], -moved[3 * tip + 1], moved[3 * tip + 2]

    def _beam(
        self, start: tuple[float, float], end: tuple[float, float], thickness: float, parts: int
    ) -> Iterable[tuple[int, int, float]]:
        nodes = [self._node(*point) for point in np.linspace(start, end, parts + 1)]
        return [(a, b, thickness) for a, b in pairwise(nodes)]

    def _node(self, x: float, y: float) -> int:
        point = (round(float(x), 9), round(float(y), 9))
        return self._points.setdefault(point, len(self._points))

    def _assemble(self, beams: Iterable[tuple[int, int, float]]) -> Array:
        whole = np.zeros((3 * len(self._at),) * 2)
        for a, b, thickness in beams:
            along = self._at[b] - self._at[a]
            length = float(np.hypot(*along))
            c, s = along / length
            turn = np.kron(np.eye(2), [[c, s, 0], [-s, c, 0], [0, 0, 1]])
            places = np.r_[3 * a : 3 * a + 3, 3 * b : 3 * b + 3]
            whole[np.ix_(places, places)] += turn.T @ self._element(length, thickness) @ turn
        return whole

    def _element(self, length: float, thickness: float) -> Array:
        """Stiffness (6, 6) of one beam against (along, across, rotation) of both ends."""
        stretch = self._modulus * thickness * self._width / length
        bend = self._modulus * self._width * thickness**3 / 12 / length**3
        k = np.zeros((6, 6))
        k[np.ix_([0, 3], [0, 3])] = stretch * np.array([[1, -1], [-1, 1]])
        across = [[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]]
        units = np.diag([1, length, 1, length])
        k[np.ix_([1, 2, 4, 5], [1, 2, 4, 5])] = bend * units @ np.array(across) @ units
        return k


def bent(finger: FinRay, height: float, force: float) -> Array:
    """Angles (n,) of the springs, rad, that balance a small force (N) on the front wall at a height (m)."""
    arms = slip_jacobian(finger)
    stiffness = np.diag(hinge_stiffness(finger)) + arms.T @ slip_stiffness(finger) @ arms
    return np.linalg.solve(stiffness, -force * np.maximum(height - finger.hinge_heights, 0.0))


def compliance(finger: FinRay, height: float) -> float:
    """Deflection of the front wall at a height per small force, m/N."""
    return float(-np.maximum(height - finger.hinge_heights, 0.0) @ bent(finger, height, 1.0))
