"""Hands remember grasps that failed, and reach as far as the bench allows."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np

from yamsim_cli.core.expert.planning.ik import Tolerance
from yamsim_cli.core.expert.skills.bench import Bench
from yamsim_cli.core.expert.skills.hand import PASSING, RESERVE, Hand, Held
from yamsim_cli.core.geometry.se3 import inverse, pose, rotation_from_vector, rotation_z

_GRIP = pose((0.0, 0.0, 0.1), rotation_from_vector([math.pi, 0.0, 0.0]))


def _hand() -> Hand:
    nothing: Any = None
    hand = Hand(0, "left", nothing, nothing, nothing, np.zeros(6), 0.0)
    hand.failed_grasps.append(Held("can", inverse(_GRIP)))
    return hand


def test_a_failed_grasp_counts_however_the_hand_is_turned_about_its_axis() -> None:
    hand = _hand()
    assert hand.failed_with("can", _GRIP)
    assert hand.failed_with("can", _GRIP @ pose((0.0, 0.005, 0.0), rotation_z(math.pi)))


def test_a_failed_grasp_does_not_count_for_another_thing_place_or_side() -> None:
    hand = _hand()
    assert not hand.failed_with("cup", _GRIP)
    assert not hand.failed_with("can", _GRIP @ pose((0.0, 0.02, 0.0)))
    assert not hand.failed_with("can", _GRIP @ pose(rotation=rotation_from_vector([0.0, math.radians(30), 0.0])))


def test_hands_keep_the_reserve_and_lean_only_within_the_context() -> None:
    used: list[Tolerance] = []
    hand = _hand()
    ik: Any = SimpleNamespace(reach=lambda T, seeds, tolerance: used.append(tolerance))
    hand.ik = ik
    bench: Any = SimpleNamespace(hands=(hand,))
    with Bench.reserve(bench, RESERVE, leans=True):
        hand.reach(_GRIP, [hand.ready], PASSING)
        hand.reach(_GRIP, [hand.ready])
    hand.reach(_GRIP, [hand.ready], PASSING)
    assert [(one.margin, one.leans) for one in used] == [(RESERVE, True), (RESERVE, False), (PASSING.margin, False)]
