"""Hands remember failed grasps, and reach as far as the planning context allows."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np

from yamsim_cli.core.expert.planning.ik import Tolerance
from yamsim_cli.core.expert.skills.hand import PREFERRED_JOINT_MARGIN, WAYPOINT_TOLERANCE, Hand, HeldObject
from yamsim_cli.core.expert.skills.planning_context import PlanningContext
from yamsim_cli.core.geometry.se3 import invert_pose, pose, rotation_from_vector, rotation_z

_GRIP = pose((0.0, 0.0, 0.1), rotation_from_vector([math.pi, 0.0, 0.0]))


def _hand() -> Hand:
    nothing: Any = None
    hand = Hand(0, "left", nothing, nothing, nothing, np.zeros(6), 0.0)
    hand.failed_grasps.append(HeldObject("can", invert_pose(_GRIP)))
    return hand


def test_a_failed_grasp_counts_however_the_hand_is_turned_about_its_axis() -> None:
    hand = _hand()
    assert hand.is_similar_to_failed_grasp("can", _GRIP)
    assert hand.is_similar_to_failed_grasp("can", _GRIP @ pose((0.0, 0.005, 0.0), rotation_z(math.pi)))


def test_a_failed_grasp_does_not_count_for_another_thing_place_or_side() -> None:
    hand = _hand()
    assert not hand.is_similar_to_failed_grasp("cup", _GRIP)
    assert not hand.is_similar_to_failed_grasp("can", _GRIP @ pose((0.0, 0.02, 0.0)))
    assert not hand.is_similar_to_failed_grasp(
        "can", _GRIP @ pose(rotation=rotation_from_vector([0.0, math.radians(30), 0.0]))
    )


def test_hands_keep_the_reserve_and_lean_only_within_the_context() -> None:
    used: list[Tolerance] = []
    hand = _hand()
    ik: Any = SimpleNamespace(solve_from=lambda T, seeds, tolerance: used.append(tolerance))
    hand.ik = ik
    bench: Any = SimpleNamespace(hands=(hand,))
    with PlanningContext.planning_limits(bench, PREFERRED_JOINT_MARGIN, allow_tilt=True):
        hand.solve_ik(_GRIP, [hand.ready_joints], WAYPOINT_TOLERANCE)
        hand.solve_ik(_GRIP, [hand.ready_joints])
    hand.solve_ik(_GRIP, [hand.ready_joints], WAYPOINT_TOLERANCE)
    assert [(one.joint_limit_margin, one.allow_tilt) for one in used] == [
        (PREFERRED_JOINT_MARGIN, True),
        (PREFERRED_JOINT_MARGIN, False),
        (WAYPOINT_TOLERANCE.joint_limit_margin, False),
    ]
