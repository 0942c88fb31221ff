"""Whether two boards' prints are of the sizes that the rig says: each tells of the other's."""

from __future__ import annotations

import numpy as np

from ..geometry.se3 import Array
from ..vision.fiducials.sighting import Sighting

# How far arms stand from where their rig says: along the margin, and any way, m (standard deviations).
_MARGIN_SIGMA, _PLACE_SIGMA = 0.005, 0.002
# Chi squared that a print of another size has to explain, and that it may leave.
_EXPLAINED, _LEFT = 25.0, 14.0
# A difference of size that matters.
_MATTERS = 0.01


def size_ratio(one: Sighting, two: Sighting, T_two_in_one: Array, along: Array) -> float | None:
    """How much larger the second print has to be, beside the first, for the boards to lie as they are known to.

    A print that is smaller than it is said to be looks farther away: it lies off along the line of sight, and nothing
    else does that.

    Args:
        one, two: boards with a pose.
        T_two_in_one: pose (4, 4) of the second board in the first one's frame, by the rig.
        along: the direction (3,) of the margin in the camera's frame.

    Returns:
        The ratio; None where the prints agree, or lie apart in a way that sizes do not explain.
    """
    assert one.T_board_in_cam is not None and two.T_board_in_cam is not None
    assert one.covariance is not None and two.covariance is not None
    assert one.shared is not None and two.shared is not None
    expected = one.T_board_in_cam @ T_two_in_one
    lever = expected[:3, 3] - one.T_board_in_cam[:3, 3]
    # A small turn w of the first board moves the second by w x lever.
    x, y, z = lever
    swung = np.column_stack([np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]]), np.eye(3)])
    own_one: Array = one.covariance - one.shared @ one.shared.T
    own_two: Array = two.covariance - two.shared @ two.shared.T
    shared: Array = two.shared[3:] - swung @ one.shared
    noise = swung @ own_one @ swung.T + own_two[3:, 3:] + shared @ shared.T
    noise = noise + _PLACE_SIGMA**2 * np.eye(3) + _MARGIN_SIGMA**2 * np.outer(along, along)
    off = two.T_board_in_cam[:3, 3] - expected[:3, 3]
    # What another size does: the whole way from the camera, longer or shorter.
    way = two.T_board_in_cam[:3, 3]
    weighted = np.linalg.solve(noise, np.column_stack([off, way]))
    growth = -float(way @ weighted[:, 0]) / float(way @ weighted[:, 1])
    before = float(off @ weighted[:, 0])
    left = before - growth**2 * float(way @ weighted[:, 1])
    if before - left < _EXPLAINED or left > _LEFT or abs(growth) < _MATTERS:
        return None
    return 1.0 + growth
