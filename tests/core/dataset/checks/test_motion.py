"""Which motion a camera's pictures have to show."""

from __future__ import annotations

import numpy as np

from yamsim_cli.core.dataset.checks.motion import ArmData, ArmLimits, angles_shown

LIMITS = ArmLimits((), 3, None)
MOVING = ArmData(LIMITS, {k: np.array([0.1 * k, 0.0]) for k in range(4)}, {})
STILL = ArmData(LIMITS, {k: np.zeros(2) for k in range(4)}, {})


def test_a_wrist_camera_shows_the_motion_of_its_own_arm_alone() -> None:
    shown = angles_shown("right", [MOVING, STILL], {"left": 0, "right": 1})
    assert all(np.array_equal(shown[k], np.zeros(2)) for k in range(4))
    assert angles_shown("left", [MOVING, STILL], {"left": 0, "right": 1})[3][0] > 0.2


def test_any_other_camera_shows_all_arms() -> None:
    assert angles_shown("top", [MOVING, STILL], {"left": 0})[3].shape == (4,)
    assert angles_shown("top", [], {}) == {}
