"""A flat board of ArUco markers.

The frame `board` has its origin at the centre, x right, y up, z out of the paper. The frame `board_cv` belongs to
OpenCV's `GridBoard`: origin at the top-left corner, x right, y down, z into the paper.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .se3 import Array


@dataclass(frozen=True)
class Board:
    """A grid of square markers, numbered row by row from the top left.

    Attributes:
        first_id: id of the top-left marker; the ids of the others follow.
        dictionary: OpenCV's predefined dictionary, such as "DICT_6X6_250".
        marker_length: edge of a marker, m.
        gap: between the edges of neighbouring markers, m.
    """

    name: str
    first_id: int
    columns: int
    rows: int
    dictionary: str
    marker_length: float
    gap: float

    @property
    def marker_ids(self) -> tuple[int, ...]:
        """Marker ids, row by row from the top left."""
        return tuple(range(self.first_id, self.first_id + self.columns * self.rows))

    @property
    def width(self) -> float:
        """Width over all markers, m."""
        return self.columns * self.marker_length + (self.columns - 1) * self.gap

    @property
    def height(self) -> float:
        """Height over all markers, m."""
        return self.rows * self.marker_length + (self.rows - 1) * self.gap

    def marker_corners(self) -> Array:
        """Return marker corners (n, 4, 3) in `board`, m, in the order of `marker_ids`, clockwise from the top left."""
        step = self.marker_length + self.gap
        length = self.marker_length
        corners = np.zeros((self.columns * self.rows, 4, 3))
        for k in range(len(corners)):
            row, column = divmod(k, self.columns)
            left, top = column * step - self.width / 2, self.height / 2 - row * step
            right, bottom = left + length, top - length
            corners[k, :, :2] = [(left, top), (right, top), (right, bottom), (left, bottom)]
        return corners

    def outer_corners(self) -> Array:
        """Return the board's corners (4, 3) in `board`, m, clockwise from the top left."""
        x, y = self.width / 2, self.height / 2
        return np.array([[-x, y, 0.0], [x, y, 0.0], [x, -y, 0.0], [-x, -y, 0.0]])
