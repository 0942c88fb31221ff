"""A recording that is not what it seems is noticed, and a good one is left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.core.recordings.making import swinging
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.motion import ArmMotion, Motion
from yamsim_cli.core.recordings.faults import MotionFault, MotionProblem, find_faults
from yamsim_cli.core.resources import Locations


@pytest.fixture(scope="module", params=["single", "russet", "yam_station_linear_4310_d405"])
def rig(request: pytest.FixtureRequest, locations: Locations) -> RigConfig:
    return load_config(RigConfig, "rigs", request.param, locations)


@pytest.fixture(scope="module")
def pair(locations: Locations) -> RigConfig:
    return load_config(RigConfig, "rigs", "russet", locations)


def only(motion: Motion, rig: RigConfig) -> MotionProblem:
    (problem,) = find_faults(motion, rig)
    return problem


def with_first(motion: Motion, **changes: object) -> Motion:
    """A motion whose first arm is another."""
    return replace(motion, arms=(replace(motion.arms[0], **changes), *motion.arms[1:]))  # type: ignore[arg-type]


def test_a_good_motion_has_none(rig: RigConfig) -> None:
    assert find_faults(swinging(rig), rig) == []


def test_a_gap_is_told_with_its_time_and_length(rig: RigConfig) -> None:
    motion = swinging(rig)
    kept = np.r_[0:100, 180:400]
    cut = Motion(
        "cut",
        motion.times[kept],
        tuple(
            ArmMotion(arm.side, arm.joints[kept], None if arm.commands is None else arm.commands[kept])
            for arm in motion.arms
        ),
    )
    problem = next(one for one in find_faults(cut, rig) if one.fault is MotionFault.GAP)
    assert problem.time == pytest.approx(0.99)
    assert "0.81 s" in problem.text


def test_degrees_are_told(rig: RigConfig) -> None:
    motion = swinging(rig)
    problem = only(with_first(motion, joints=np.rad2deg(motion.arms[0].joints)), rig)
    assert problem.fault is MotionFault.DEGREES
    assert "degrees" in problem.text


def test_a_joint_beyond_its_stops_is_named(rig: RigConfig) -> None:
    motion = swinging(rig)
    joints = motion.arms[0].joints.copy()
    joints[:, 1] -= 2.0
    problem = only(with_first(motion, joints=joints), rig)
    assert problem.fault is MotionFault.BEYOND_STOPS
    assert "joint2 is at" in problem.text


def test_a_jump_is_told_with_its_time(rig: RigConfig) -> None:
    motion = swinging(rig)
    joints = motion.arms[0].joints.copy()
    joints[200:, 3] += 0.4
    problem = only(with_first(motion, joints=joints), rig)
    assert (problem.fault, problem.time) == (MotionFault.TOO_FAST, pytest.approx(1.99))
    assert "joint4 jumps" in problem.text


def test_a_joint_that_froze_is_told(rig: RigConfig) -> None:
    motion = swinging(rig)
    joints = motion.arms[0].joints.copy()
    joints[150:, 4] = joints[150, 4]
    problem = only(with_first(motion, joints=joints), rig)
    assert (problem.fault, problem.time) == (MotionFault.FROZEN, pytest.approx(1.5))
    assert "joint5 was measured" in problem.text


def test_a_gripper_in_shares_is_told(rig: RigConfig) -> None:
    motion = swinging(rig)
    shares = with_first(motion, openings=motion.arms[0].openings / 0.03)  # type: ignore[operator]
    assert only(shares, rig).fault is MotionFault.GRIPPER_SHARE


def test_a_gripper_upside_down_is_told(rig: RigConfig) -> None:
    motion = swinging(rig)
    openings = motion.arms[0].openings
    assert openings is not None
    problem = only(with_first(motion, openings=openings.max() - openings), rig)
    assert problem.fault is MotionFault.GRIPPER_UPSIDE_DOWN


@pytest.mark.parametrize(("upside_down", "told"), [(False, []), (True, [MotionFault.GRIPPER_STALLS_OPENING])])
def test_a_gripper_that_things_keep_from_opening_may_be_upside_down(
    upside_down: bool, told: list[MotionFault], rig: RigConfig
) -> None:
    """Fingers close onto a thing of 30 mm and hold it. Mirrored altogether, they would be kept from opening."""
    motion = swinging(rig, 4.0)
    fingers = rig.arms[rig.recorded[0]].robot.fingers
    assert fingers is not None
    full = fingers.full_opening
    wanted = full * (1 - np.clip((motion.times - 0.5) / 0.3, 0, 1))
    measured = np.maximum(wanted, 0.015)
    if upside_down:
        wanted, measured = full - wanted, full - measured
    found = find_faults(with_first(motion, openings=measured, commanded_openings=wanted), rig)
    assert [problem.fault for problem in found] == told
    assert all("--mirror-gripper both" in problem.text for problem in found)


def test_swapped_arms_are_told(pair: RigConfig) -> None:
    motion = swinging(pair)
    left, right = motion.arms
    swapped = replace(motion, arms=(replace(left, joints=right.joints), replace(right, joints=left.joints)))
    assert only(swapped, pair).fault is MotionFault.SWAPPED_ARMS


def test_what_was_not_measured_at_a_sample_is_no_fault(rig: RigConfig) -> None:
    motion = swinging(rig)
    arms = []
    for arm in motion.arms:
        joints = arm.joints.copy()
        joints[1::2] = np.nan
        arms.append(replace(arm, joints=joints, openings=None))
    assert find_faults(replace(motion, arms=tuple(arms)), rig) == []
