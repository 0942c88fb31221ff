"""What outlines of flat boards say of the focal length of the camera that saw them: how well each one explains them.

A board seen at a slant shrinks towards its far edge, and how much so tells its distance apart from its size in the
picture. Seen straight on it does not, and any lens explains it. So no one value is sought: for every focal length, each
board takes the pose that explains its outline best, and what is left over (chi squared) is what speaks against it.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ...geometry.se3 import Array
from .outline import Outline

# How far real lenses are from the centred pinhole that is looked for: standard deviations of the principal point, image
# widths, and of the distortion k1.
CENTRE_SIGMA = 0.01
BEND_SIGMA = 0.05
_LENS_SIGMAS = np.array([CENTRE_SIGMA, CENTRE_SIGMA, BEND_SIGMA])
# How often the lens is looked for anew once the poses have followed it, and the longest step, standard deviations.
_LENS_ROUNDS = 3
_LENS_STEP = 3.0

_STEPS = 8


@dataclass(frozen=True)
class Profile:
    """How well each focal length explains the outlines.

    Attributes:
        spread: image widths in a focal length (n,), each explained by its best poses and lens.
        misfit: chi squared (n,).
        lens: the principal point's shift (image widths, right and down) and k1 that go with each (n, 3).
        lens_covariance: (n, 3, 3) of these, at a fixed focal length.
    """

    spread: Array
    misfit: Array
    lens: Array
    lens_covariance: Array


def profile(outlines: Sequence[Outline], size: tuple[int, int], spread: Array) -> Profile:
    """Explain outlines of boards by each of several focal lengths.

    Args:
        outlines: of one camera's photos, all of them together.
        size: of its photos, width and height in px.
        spread: the longer side over the focal length, for each (n,).
    """
    fits = [_poses(outline, size, spread) for outline in outlines]
    lens = np.zeros((len(spread), 3))
    for _ in range(_LENS_ROUNDS):
        chosen = _Evidence.chosen([[_evidence(fit, lens) for fit in pair] for pair in fits], lens)
        misfit, step, covariance = chosen.best(lens)
        lens = lens + np.clip(step, -_LENS_STEP * _LENS_SIGMAS, _LENS_STEP * _LENS_SIGMAS)
    return Profile(spread, misfit, lens, covariance)


@dataclass(frozen=True)
class _Evidence:
    """What boards say of the lens at each of n focal lengths, each board at its best pose: normal equations.

    Attributes:
        information, gradient, misfit: (n, 3, 3), (n, 3) and (n,).
    """

    information: Array
    gradient: Array
    misfit: Array

    def __add__(self, other: _Evidence) -> _Evidence:
        return _Evidence(
            self.information + other.information, self.gradient + other.gradient, self.misfit + other.misfit
        )

    def where(self, take: NDArray[np.bool_], other: _Evidence) -> _Evidence:
        """This one for some focal lengths, another for the rest."""
        return _Evidence(
            np.where(take[:, None, None], self.information, other.information),
            np.where(take[:, None], self.gradient, other.gradient),
            np.where(take, self.misfit, other.misfit),
        )

    def best(self, lens: Array) -> tuple[Array, Array, Array]:
        """Chi squared with the best lens, the step (n, 3) there from `lens`, and its covariance."""
        prior = _LENS_SIGMAS**-2.0
        covariance = np.linalg.inv(self.information + np.diag(prior))
        gradient = self.gradient + prior * lens
        step = -np.einsum("nij,nj->ni", covariance, gradient)
        return self.misfit + (prior * lens**2).sum(axis=1) + (gradient * step).sum(axis=1), step, covariance

    @classmethod
    def chosen(cls, pairs: Sequence[Sequence[_Evidence]], lens: Array) -> _Evidence:
        """All boards together, each in that of its two poses which goes best with the others."""
        taken = [one.where(one.misfit <= two.misfit, two) for one, two in pairs]
        total = functools.reduce(cls.__add__, taken)
        for k, pair in enumerate(pairs):
            others = functools.reduce(cls.__add__, taken[:k] + taken[k + 1 :]) if len(taken) > 1 else None
            sums = [one if others is None else others + one for one in pair]
            first = sums[0].best(lens)[0] <= sums[1].best(lens)[0]
            taken[k], total = pair[0].where(first, pair[1]), sums[0].where(first, sums[1])
        return total


def _evidence(fit: _Poses, lens: Array) -> _Evidence:
    fit.descend(lens)
    residual, by_pose, by_lens = fit.equations()
    # What the pose makes up for is no word on the lens.
    q, _ = np.linalg.qr(by_pose)
    own = by_lens - q @ (np.swapaxes(q, 1, 2) @ by_lens)
    return _Evidence(
        np.swapaxes(own, 1, 2) @ own, np.einsum("nij,ni->nj", own, residual), (residual**2).sum(axis=1)
    )


def _poses(outline: Outline, size: tuple[int, int], spread: Array) -> list[_Poses]:
    """The two poses that a flat board may have, for each focal length.

    Lengths in the picture are in its longer side, those on the board in its width.
    """
    longer = max(size)
    seen = (outline.points - (np.array(size) - 1) / 2) / longer
    whiten = np.linalg.inv(np.linalg.cholesky(outline.covariance / longer**2))
    on_board = outline.on_board / outline.board.width
    return [_Poses(on_board, seen, whiten, spread, *start) for start in _starts(on_board, seen, spread)]


def _starts(on_board: Array, seen: Array, spread: Array) -> list[tuple[Array, Array, Array]]:
    """Two sets of poses to start from, a pose for each focal length: turns, middles in the picture, and sizes there."""
    points = np.column_stack([on_board, np.zeros(4)])
    sets = []
    for value in spread:
        _, turns, shifts, _ = cv2.solvePnPGeneric(
            points, seen * value, np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_IPPE
        )
        found = [(cv2.Rodrigues(turn)[0], shift.ravel()) for turn, shift in zip(turns, shifts, strict=True)]
        sets.append([found[0], found[-1]])
    starts = []
    for k in (0, 1):
        turns = np.array([pair[k][0] for pair in sets])
        shifts = np.array([pair[k][1] for pair in sets])
        sizes = 1 / (shifts[:, 2] * spread)
        starts.append((turns, shifts[:, :2] * sizes[:, None], sizes))
    return starts


class _Poses:
    """A pose of one board for each of n focal lengths, all refined at once.

    With `size` for how large the board is in the picture and `middle` for where, a point u of the board, turned to y,
    is seen at (middle + size y_xy) / (1 + spread size y_z): without a limit where the lens is ever longer.
    """

    def __init__(
        self, on_board: Array, seen: Array, whiten: Array, spread: Array, turns: Array, middles: Array, sizes: Array
    ) -> None:
        self._on_board, self._seen, self._whiten, self._spread = on_board, seen, whiten, spread
        self._turns, self._middles, self._sizes = turns, middles, sizes
        self._lens = np.zeros((len(spread), 3))

    def descend(self, lens: Array) -> None:
        """Levenberg and Marquardt's steps, seen through a lens (n, 3)."""
        self._lens = lens
        damping = np.full(len(self._spread), 1e-3)
        residual, by_pose, _ = self.equations()
        cost = (residual**2).sum(axis=1)
        for _ in range(_STEPS):
            normal = np.swapaxes(by_pose, 1, 2) @ by_pose
            diagonal = np.einsum("nii->ni", normal)
            normal = normal + damping[:, None, None] * np.eye(6) * diagonal[:, None, :]
            step = -np.linalg.solve(normal, np.einsum("nij,ni->nj", by_pose, residual)[..., None])[..., 0]
            before = self._turns, self._middles, self._sizes
            self._move(step)
            trial, trial_by_pose, _ = self.equations()
            better = (trial**2).sum(axis=1) < cost
            self._turns = np.where(better[:, None, None], self._turns, before[0])
            self._middles = np.where(better[:, None], self._middles, before[1])
            self._sizes = np.where(better, self._sizes, before[2])
            residual = np.where(better[:, None], trial, residual)
            by_pose = np.where(better[:, None, None], trial_by_pose, by_pose)
            cost = (residual**2).sum(axis=1)
            damping = np.where(better, damping / 8, damping * 8)

    def _move(self, step: Array) -> None:
        angle = np.linalg.norm(step[:, :3], axis=1)
        axis = step[:, :3] / np.maximum(angle, 1e-12)[:, None]
        cross = np.zeros((len(step), 3, 3))
        cross[:, [2, 0, 1], [1, 2, 0]] = axis
        cross[:, [1, 2, 0], [2, 0, 1]] = -axis
        sine, cosine = np.sin(angle)[:, None, None], 1 - np.cos(angle)[:, None, None]
        self._turns = (np.eye(3) + sine * cross + cosine * cross @ cross) @ self._turns
        self._middles = self._middles + step[:, 3:5]
        self._sizes = self._sizes * np.exp(np.clip(step[:, 5], -1, 1))

    def equations(self) -> tuple[Array, Array, Array]:
        """Residuals (n, 8), and their derivatives by the pose (n, 8, 6) and by the lens (n, 8, 3)."""
        turned = self._on_board @ np.swapaxes(self._turns[:, :, :2], 1, 2) * self._sizes[:, None, None]
        x, y, z = (turned[..., k] for k in range(3))
        spread = self._spread[:, None]
        w = np.maximum(1 + spread * z, 1e-3)
        at = (self._middles[:, None, :] + turned[..., :2]) / w[..., None]
        n, zero, one = len(spread), np.zeros_like(x), np.ones_like(x)
        by_pose = np.empty((n, 4, 2, 6))
        for row, (moves_x, moves_y) in enumerate(((zero, -z), (z, zero), (-y, x))):
            moves_z = (y, -x, zero)[row]
            by_pose[..., 0, row] = (moves_x - at[..., 0] * spread * moves_z) / w
            by_pose[..., 1, row] = (moves_y - at[..., 1] * spread * moves_z) / w
        by_pose[..., 3] = np.stack([one / w, zero], axis=-1)
        by_pose[..., 4] = np.stack([zero, one / w], axis=-1)
        by_pose[..., 5] = (turned[..., :2] - at * (w - 1)[..., None]) / w[..., None]
        by_lens = np.zeros((n, 4, 2, 3))
        by_lens[..., 0, 0] = by_lens[..., 1, 1] = 1.0
        squared = (at**2).sum(axis=-1)[..., None] * spread[..., None] ** 2
        by_lens[..., 2] = at * squared
        k1 = self._lens[:, None, None, 2]
        bent = at * (1 + k1 * squared) + self._lens[:, None, :2]
        outwards = 2 * k1 * spread[..., None] ** 2 * at
        by_pose = by_pose * (1 + k1 * squared)[..., None] + outwards[..., None] * (at[..., None, :] @ by_pose)
        residual = (bent - self._seen).reshape(n, 8) @ self._whiten.T
        return residual, self._whiten @ by_pose.reshape(n, 8, 6), self._whiten @ by_lens.reshape(n, 8, 3)
