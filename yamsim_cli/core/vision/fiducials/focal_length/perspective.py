"""What outlines of flat boards say of the focal length of the camera that saw them: how well each one explains them.

A board seen at a slant shrinks towards its far edge, and how much so tells its distance apart from its size in the
picture. Seen straight on it does not, and any lens explains it. So no one value is sought: for every focal length, each
board takes the pose that explains its outline best, and what is left over (chi squared) is what speaks against it.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....geometry.least_squares import LeastSquares, descend
from ....geometry.se3 import Array
from .board_poses import BoardPoses, Poses, poses_of
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
    lens = np.zeros((len(spread), 3))
    if near is not None:
        lens = np.column_stack([np.interp(spread, near.spread, near.lens[:, k]) for k in range(3)])
    problem = _LensProblem([poses_of(outline, size, spread) for outline in outlines])
    found = descend(problem, problem.start(lens), _LENS_ROUNDS)
    assert found is not None  # the evidence can always be told
    state, known = found
    return Profile(spread, known.cost, state.lens, known.covariance())


@dataclass(frozen=True)
class _Seen:
    """A lens (n, 3) for each focal length, and each board's two poses seen through it."""

    lens: Array
    poses: tuple[tuple[Poses, ...], ...]


@dataclass(frozen=True)
class _Evidence:
    """What boards, each at its best pose, say of the lens at each of n focal lengths, with what lenses usually are.

    Attributes:
        information, slope, misfit: of the boards alone, (n, 3, 3), (n, 3) and (n,).
        lens: that the boards are seen through (n, 3).
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
        """What one board says."""
        residual, by_pose, by_lens = board.equations(poses, lens)
        # What the pose makes up for is no word on the lens.
        q, _ = np.linalg.qr(by_pose)
        own = by_lens - q @ (np.swapaxes(q, 1, 2) @ by_lens)
        left = residual - (q @ (np.swapaxes(q, 1, 2) @ residual[..., None]))[..., 0]
        return cls(np.swapaxes(own, 1, 2) @ own, np.einsum("nij,ni->nj", own, left), (left**2).sum(axis=1), lens)

    def where(self, take: NDArray[np.bool_], other: _Evidence) -> _Evidence:
        """This one for some focal lengths, another for the rest."""
        return _Evidence(
            np.where(take[:, None, None], self.information, other.information),
            np.where(take[:, None], self.slope, other.slope),
            np.where(take, self.misfit, other.misfit),
            np.where(take[:, None], self.lens, other.lens),
        )

    @property
    def cost(self) -> Array:
        """Chi squared (n,), and how unusual the lens is."""
        cost: Array = self.misfit + (self.lens**2 / _LENS_SIGMAS**2).sum(axis=1)
        return np.where(np.isfinite(cost), cost, _NEVER)

    @property
    def normal(self) -> Array:
        """Of the lens (n, 3, 3), with what lenses usually are."""
        return np.nan_to_num(self.information) + np.diag(_LENS_SIGMAS**-2.0)

    @property
    def gradient(self) -> Array:
        """The normal equations' right-hand side (n, 3)."""
        return -np.nan_to_num(self.slope + _LENS_SIGMAS**-2.0 * self.lens)

    def covariance(self) -> Array:
        """Of the lens (n, 3, 3), with what lenses usually are."""
        return np.linalg.inv(self.normal).astype(np.float64)


class _LensProblem(LeastSquares[_Seen, _Evidence]):
    """Least squares over the lens, at each focal length for itself; all boards' poses follow it."""

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
            taken.append(one.where(one.misfit <= np.nan_to_num(two.misfit, nan=_NEVER), two))
        return functools.reduce(_Evidence.__add__, taken)

    def moved(self, state: _Seen, step: Array) -> _Seen:
        return self._through(state.lens + step, state.poses)

    def settled(self, state: _Seen, known: _Evidence, step: Array, gain: Array) -> bool:
        """Whether steps were in vain for some rounds, where it matters."""
        matters = known.cost < known.cost.min() + _LIKELY
        self._idle = 0 if (gain[matters] > _LITTLE_GAIN).any() else self._idle + 1
        return self._idle == _IDLE_ROUNDS

    def better_of(
        self, better: NDArray[np.bool_], there: tuple[_Seen, _Evidence], here: tuple[_Seen, _Evidence]
    ) -> tuple[_Seen, _Evidence]:
        poses = tuple(
            tuple(new.where(better, old) for new, old in zip(*pair, strict=True))
            for pair in zip(there[0].poses, here[0].poses, strict=True)
        )
        lens = np.where(better[:, None], there[0].lens, here[0].lens)
        return _Seen(lens, poses), there[1].where(better, here[1])
