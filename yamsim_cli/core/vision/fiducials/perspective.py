"""What outlines of flat boards say of the focal length of the camera that saw them: how well each one explains them.

A board seen at a slant shrinks towards its far edge, and how much so tells its distance apart from its size in the
picture. Seen straight on it does not, and any lens explains it. So no one value is sought: for every focal length, each
board takes the pose that explains its outline best, and what is left over (chi squared) is what speaks against it.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...geometry.se3 import Array
from .board_poses import BoardPoses, poses_of
from .outline import Outline

# How far lenses are expected to be from a centred pinhole: standard deviations of the principal point, image widths
# right and down, and of the distortion k1. Source: 13 calibrations of webcams and robots' cameras that people publish;
# half of them are within these, and three in four within twice as much. Phones correct theirs and are well within.
_LENS_SIGMAS = np.array([0.02, 0.02, 0.1])
# How often the lens is looked for anew once the poses have followed it: at most, and in vain.
_LENS_ROUNDS, _IDLE_ROUNDS = 25, 2

# Where chi squared is so much worse than the best, it is no matter by how much; elsewhere, so little is no gain.
_LIKELY, _LITTLE_GAIN = 150.0, 0.03
# Chi squared of what cannot be.
_NEVER = 1e12


@dataclass(frozen=True)
class Profile:
    """How well each focal length explains the outlines.

    Attributes:
        spread: the longer side over the focal length (n,), each with its best poses and lens.
        misfit: chi squared (n,).
        lens: the principal point's shift (image widths, right and down) and k1 that go with each (n, 3).
        lens_covariance: (n, 3, 3) of these, at a fixed focal length.
    """

    spread: Array
    misfit: Array
    lens: Array
    lens_covariance: Array


def profile(outlines: Sequence[Outline], size: tuple[int, int], spread: Array, near: Profile | None = None) -> Profile:
    """Explain outlines of boards by each of several focal lengths.

    Args:
        outlines: of one camera's photos, all of them together.
        size: of its photos, width and height in px.
        spread: the longer side over the focal length, for each (n,).
        near: what is known already of focal lengths between these.
    """
    fits = [poses_of(outline, size, spread) for outline in outlines]
    lens, damping = np.zeros((len(spread), 3)), np.full(len(spread), 1e-3)
    if near is not None:
        lens = np.column_stack([np.interp(spread, near.spread, near.lens[:, k]) for k in range(3)])
    known = _Evidence.chosen(fits, lens)
    cost, idle = known.cost(lens), 0
    for _ in range(_LENS_ROUNDS):
        step = known.step(lens, damping)
        for fit in itertools.chain.from_iterable(fits):
            fit.keep()
        trial = _Evidence.chosen(fits, lens + step)
        gain = cost - trial.cost(lens + step)
        better = gain > 0
        for fit in itertools.chain.from_iterable(fits):
            fit.return_where(~better)
        known, lens = trial.where(better, known), np.where(better[:, None], lens + step, lens)
        cost, damping = np.where(better, cost - gain, cost), np.where(better, damping / 8, damping * 8)
        idle = 0 if (gain[cost < cost.min() + _LIKELY] > _LITTLE_GAIN).any() else idle + 1
        if idle == _IDLE_ROUNDS:
            break
    return Profile(spread, cost, lens, known.covariance())


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

    @classmethod
    def of(cls, fit: BoardPoses, lens: Array) -> _Evidence:
        """What one board says, once its poses have followed the lens."""
        fit.descend(lens)
        residual, by_pose, by_lens = fit.equations()
        # What the pose makes up for is no word on the lens.
        q, _ = np.linalg.qr(by_pose)
        own = by_lens - q @ (np.swapaxes(q, 1, 2) @ by_lens)
        left = residual - (q @ (np.swapaxes(q, 1, 2) @ residual[..., None]))[..., 0]
        return cls(np.swapaxes(own, 1, 2) @ own, np.einsum("nij,ni->nj", own, left), (left**2).sum(axis=1))

    def where(self, take: NDArray[np.bool_], other: _Evidence) -> _Evidence:
        """This one for some focal lengths, another for the rest."""
        return _Evidence(
            np.where(take[:, None, None], self.information, other.information),
            np.where(take[:, None], self.gradient, other.gradient),
            np.where(take, self.misfit, other.misfit),
        )

    def cost(self, lens: Array) -> Array:
        """Chi squared (n,) with the lens that it was made for, and how unusual that is."""
        cost: Array = self.misfit + (lens**2 / _LENS_SIGMAS**2).sum(axis=1)
        return np.where(np.isfinite(cost), cost, _NEVER)

    def covariance(self) -> Array:
        """Of the lens (n, 3, 3), with what lenses usually are."""
        return np.linalg.inv(np.nan_to_num(self.information) + np.diag(_LENS_SIGMAS**-2.0)).astype(np.float64)

    def step(self, lens: Array, damping: Array) -> Array:
        """The lens' step (n, 3) that Levenberg and Marquardt take."""
        prior = _LENS_SIGMAS**-2.0
        normal = np.nan_to_num(self.information) + np.diag(prior)
        gradient = np.nan_to_num(self.gradient + prior * lens)
        normal += damping[:, None, None] * np.eye(3) * np.einsum("nii->ni", normal)[:, None, :]
        return -np.linalg.solve(normal, gradient[..., None])[..., 0].astype(np.float64)

    @classmethod
    def chosen(cls, fits: Sequence[Sequence[BoardPoses]], lens: Array) -> _Evidence:
        """All boards together, each in the better of its two poses."""
        pairs = [[cls.of(fit, lens) for fit in pair] for pair in fits]
        taken = [one.where(one.misfit <= np.nan_to_num(two.misfit, nan=_NEVER), two) for one, two in pairs]
        return functools.reduce(cls.__add__, taken)
