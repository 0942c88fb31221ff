"""What is said of a board in a photo: its pose, or why there is none."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from ...geometry.board import Board
from ...geometry.se3 import Array
from .fitting.smear import Smear


class Status(StrEnum):
    """What became of a board."""

    OK = "ok"
    NOT_FOUND = "not_found"
    AMBIGUOUS = "ambiguous"
    POOR_FIT = "poor_fit"
    UNCERTAIN = "uncertain"


@dataclass(frozen=True)
class Sighting:
    """A board in a photo.

    Attributes:
        markers: ids of its markers that were read or, once the pose was known, recognized by their print.
        status: OK where there is a pose that is sure enough; UNCERTAIN where its uncertainty is beyond the limits.
        reason: why it is not OK, for a person; else empty.
        T_board_in_cam: pose (4, 4) of the `board` frame (origin at the centre, z out of the paper), or None
            where the board was refused.
        covariance: (6, 6) of a small rotation (rad) about the board's centre and of its shift (m), both along the
            camera's axes: noise, the print's shape, and what the lens and the print's scale are known to.
        shared: (6, k) the part of it that is the same mistake for all boards of a photo: what one standard deviation of
            each mistake does to the pose; first the focal length's, last the print scale's.
        reprojection_rms: root mean square of how far (px) each marker's picture lies from where the pose puts it.
        smear: about the photo's blur and motion, px; of a board that fills the photo, at most so much.
        twice: its print is in the photo more than once.
        advice: what would help, of a board that is not located.
    """

    board: Board
    markers: tuple[int, ...]
    status: Status
    reason: str = ""
    T_board_in_cam: Array | None = None
    covariance: Array | None = None
    shared: Array | None = None
    reprojection_rms: float | None = None
    smear: Smear | None = None
    twice: bool = False
    advice: tuple[str, ...] = ()

    @property
    def explanation(self) -> str:
        """Why there is no pose and what would help, for a person; empty with a pose."""
        return f"{self.reason}; would help: {', '.join(self.advice)}" if self.advice else self.reason

    @property
    def position_sigma(self) -> float | None:
        """Standard deviation of the centre's position, all axes together, m."""
        return None if self.covariance is None else math.sqrt(float(np.trace(self.covariance[3:, 3:])))

    @property
    def own_position_sigma(self) -> float | None:
        """Standard deviation of the centre's position, m, without what is shared by all boards of a photo."""
        if self.covariance is None or self.shared is None:
            return None
        return math.sqrt(max(0.0, float(np.trace((self.covariance - self.shared @ self.shared.T)[3:, 3:]))))

    @property
    def rotation_sigma(self) -> float | None:
        """Standard deviation of the orientation, all axes together, rad."""
        return None if self.covariance is None else math.sqrt(float(np.trace(self.covariance[:3, :3])))
