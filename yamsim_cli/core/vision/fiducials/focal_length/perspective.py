"""The misfit of each focal length to the outlines of flat boards.

A board seen at a slant shrinks towards its far edge, which separates its distance from its size in the picture. Seen
straight on, any lens explains the outline. So a whole range is evaluated: at every focal length, each board takes the
pose that explains its outline best, and the remaining chi squared is the misfit.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....geometry.least_squares import LeastSquares, descend
from ....geometry.se3 import Array
from .board_poses import BoardPoses, Poses, choose, poses_of
from .outline import Outline

# Prior of lenses: standard deviations of the principal point, image widths right and down, and of the distortion k1.
# Source: 13 published calibrations of webcams and robots' cameras, half of which are within these, and three in four
# within twice as much. Phones correct their distortion and are well within.
_LENS_SIGMAS = np.array([0.02, 0.02, 0.1])
_LENS_ROUNDS = 25  # rounds of lens and poses at most
_IDLE_ROUNDS = 2  # rounds without gain that end the search
_LIKELY = 150.0  # chi squared above the best, from which the exact value does not matter
_LITTLE_GAIN = 0.03  # chi squared, gain that does not count
_NEVER = 1e12  # chi squared of impossible states


@dataclass(frozen=True)
class Profile:
    """The misfit of focal lengths to the outlines, with the best lens of each.

    Attributes:
        spread: the longer side over the focal length (n,).
        misfit: chi squared (n,).
        lens: the principal point's shift (image widths, right and down) and k1 (n, 3).
        lens_covariance: (n, 3, 3) of `lens`, at a fixed focal length.
    """

    spread: Array
    misfit: Array
    lens: Array
    lens_covariance: Array


def profile(outlines: Sequence[Outline], size: tuple[int, int], spread: Array, near: Profile | None = None) -> Profile:
    """The misfit of focal lengths to outlines.

    Args:
        outlines: from all photos of one camera.
        size: width and height of the photos, px.
        spread: the longer side over the focal length (n,).
        near: a coarser profile, for lenses to start from.
    """
    lens = np.zeros((len(spread), 3))
    if near is not None:
        lens = np.column_stack([np.interp(spread, near.spread, near.lens[:, k]) for k in range(3)])
    problem = _LensProblem([poses_of(outline, size, spread) for outline in outlines])
    found = descend(problem, problem.start(lens), _LENS_ROUNDS)
    assert found is not None  # the evidence exists at every state
    state, known = found
    return Profile(spread, known.cost, state.lens, known.covariance())


@dataclass(frozen=True)
class _Seen:
    """A lens (n, 3) for each focal length, and each board's two poses seen through it."""

    lens: Array
    poses: tuple[tuple[Poses, ...], ...]


@dataclass(frozen=True)
class _Evidence:
    """The evidence of boards, each at its best pose, on the lens at each of n focal lengths.

    Attributes:
        information, slope, misfit: from the boards alone, (n, 3, 3), (n, 3) and (n,).
        lens: the lens (n, 3) through which the boards are seen.
    """

    information: Array
    slope: Array
    misfit: Array
    lens: Array

    def __add__(self, other: _Evidence) -> _Evidence:
        return _Evidence(
            self.information + other.information, self.slope + other.slope, self.misfit + other.misfit, self.lens
        )

    @classmethod
    def of(cls, board: BoardPoses, poses: Poses, lens: Array) -> _Evidence:
        """The evidence of one board."""
        residual, by_pose, by_lens = board.equations(poses, lens)
        # What a pose can explain is projected out.
        q, _ = np.linalg.qr(by_pose)
        own = by_lens - q @ (np.swapaxes(q, 1, 2) @ by_lens)
        left = residual - (q @ (np.swapaxes(q, 1, 2) @ residual[..., None]))[..., 0]
        return cls(np.swapaxes(own, 1, 2) @ own, np.einsum("nij,ni->nj", own, left), (left**2).sum(axis=1), lens)

    @property
    def cost(self) -> Array:
        """Chi squared (n,), with the lens prior."""
        cost: Array = self.misfit + (self.lens**2 / _LENS_SIGMAS**2).sum(axis=1)
        return np.where(np.isfinite(cost), cost, _NEVER)

    @property
    def normal(self) -> Array:
        """The information (n, 3, 3) on the lens, with the prior."""
        return np.nan_to_num(self.information) + np.diag(_LENS_SIGMAS**-2.0)

    @property
    def gradient(self) -> Array:
        """The normal equations' right-hand side (n, 3)."""
        return -np.nan_to_num(self.slope + _LENS_SIGMAS**-2.0 * self.lens)

    def covariance(self) -> Array:
        """The covariance (n, 3, 3) of the lens, with the prior."""
        return np.linalg.inv(self.normal).astype(np.float64)


class _LensProblem(LeastSquares[_Seen, _Evidence]):
    """Least squares over the lens, separately at each focal length; the boards' poses follow the lens."""

    def __init__(self, boards: Sequence[Sequence[BoardPoses]]) -> None:
        self._boards = boards
        self._idle = 0

    def start(self, lens: Array) -> _Seen:
        """A lens (n, 3), and the boards seen through it."""
        return self._through(lens, [[board.first for board in pair] for pair in self._boards])

    def _through(self, lens: Array, poses: Sequence[Sequence[Poses]]) -> _Seen:
        pairs = zip(self._boards, poses, strict=True)
        return _Seen(lens, tuple(tuple(b.followed(p, lens) for b, p in zip(*pair, strict=True)) for pair in pairs))

    def linearized(self, state: _Seen, before: _Evidence | None) -> _Evidence:
        """All boards together, each in the better of its two poses."""
        taken = []
        for boards, poses in zip(self._boards, state.poses, strict=True):
            one, two = (_Evidence.of(b, p, state.lens) for b, p in zip(boards, poses, strict=True))
            taken.append(choose(one.misfit <= np.nan_to_num(two.misfit, nan=_NEVER), one, two))
        return functools.reduce(_Evidence.__add__, taken)

    def moved(self, state: _Seen, step: Array) -> _Seen:
        return self._through(state.lens + step, state.poses)

    def settled(self, state: _Seen, known: _Evidence, step: Array, gain: Array) -> bool:
        """Whether no likely focal length has gained for some rounds."""
        matters = known.cost < known.cost.min() + _LIKELY
        self._idle = 0 if (gain[matters] > _LITTLE_GAIN).any() else self._idle + 1
        return self._idle == _IDLE_ROUNDS

    def better_of(
        self, better: NDArray[np.bool_], there: tuple[_Seen, _Evidence], here: tuple[_Seen, _Evidence]
    ) -> tuple[_Seen, _Evidence]:
        poses = tuple(
            tuple(choose(better, new, old) for new, old in zip(*pair, strict=True))
            for pair in zip(there[0].poses, here[0].poses, strict=True)
        )
        lens = np.where(better[:, None], there[0].lens, here[0].lens)
        return _Seen(lens, poses), choose(better, there[1], here[1])
