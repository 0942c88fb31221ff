"""Hands remember how they held what they could not put where it was to go."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from yamsim_cli.core.geometry.se3 import inverse, pose, rotation_from_vector, rotation_z
from yamsim_cli.core.skills.hand import Hand, Held

_GRIP = pose((0.0, 0.0, 0.1), rotation_from_vector([math.pi, 0.0, 0.0]))


def _hand() -> Hand:
    nothing: Any = None
    hand = Hand(0, "left", nothing, nothing, nothing, np.zeros(6), 0.0)
    hand.failed_grasps.append(Held("can", inverse(_GRIP)))
    return hand


def test_the_same_place_from_the_same_side_is_in_vain_however_the_hand_is_turned() -> None:
    hand = _hand()
    assert hand.failed_with("can", _GRIP)
    assert hand.failed_with("can", _GRIP @ pose((0.0, 0.005, 0.0), rotation_z(math.pi)))


def test_another_thing_place_or_side_is_not() -> None:
    hand = _hand()
    assert not hand.failed_with("cup", _GRIP)
    assert not hand.failed_with("can", _GRIP @ pose((0.0, 0.02, 0.0)))
    assert not hand.failed_with("can", _GRIP @ pose(rotation=rotation_from_vector([0.0, math.radians(30), 0.0])))
