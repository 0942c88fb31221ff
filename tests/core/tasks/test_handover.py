"""The plans of a hand-over: where the two hands are, and when."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from yamsim_cli.core.tasks.handover import (
    exchange,
    exchange_pose,
    giving_plan,
    phases,
    schedule,
    taking_plan,
    wrist_turn,
)
from yamsim_cli.core.tasks.kinds import kind_of
from yamsim_cli.core.tasks.pickplace import sample_layout
from yamsim_cli.core.tasks.plans import Hold

from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.geometry.se3 import inverse, pose, rotation_z, yaw
from yamsim_cli.core.types import Layout, Plan

HEADINGS = (np.pi / 2, 0.7)


@pytest.fixture(scope="module")
def config(make_config: Callable[..., RecordConfig]) -> RecordConfig:
    return make_config({("rig",): "bimanual", ("task",): "handover"})


def _layout(config: RecordConfig, seed: int) -> Layout:
    rng = np.random.default_rng(seed)
    layout = sample_layout(config, rng)
    assert layout is not None
    return layout


def _plans(config: RecordConfig, heading: float) -> tuple[Plan, Plan, np.ndarray]:
    layout, (giving, taking) = _layout(config, 3), exchange(config.task).points
    T = exchange_pose(config.task, layout, giving, taking, heading)
    giver, taker = (config.rig.T_base_in_world(k) for k in config.acting)
    first, second = phases(config.task, config.grasp, *config.acting_scene_arms)
    task, grasp = config.task, config.grasp
    return (
        giving_plan(task, grasp, layout, giver, Hold(giving, False, 0.2), T, heading, first),
        taking_plan(task, grasp, layout, taker, Hold(taking, True, 0.2), T, heading, second),
        T,
    )


def test_the_banana_starts_before_the_right_arm_and_the_plate_stands_before_the_left_one(config: RecordConfig) -> None:
    layouts = [_layout(config, seed) for seed in range(200)]
    for name, middle in (("banana", -0.35), ("plate", 0.35)):
        y = np.array([layout.T_in_world[name][1, 3] for layout in layouts])
        assert middle - 0.18 <= y.min() < middle - 0.15
        assert middle + 0.15 < y.max() <= middle + 0.18


@pytest.mark.parametrize("heading", HEADINGS)
def test_the_two_points_lie_along_the_heading_about_the_middle(config: RecordConfig, heading: float) -> None:
    _, _, T = _plans(config, heading)
    one, other = (T @ (*point.position, 1) for point in exchange(config.task).points)
    assert np.arctan2(*(other - one)[[1, 0]]) == pytest.approx(heading)
    np.testing.assert_allclose((one + other)[:2] / 2, (exchange(config.task).x, 0), atol=1e-9)
    assert np.linalg.norm((other - one)[:3]) > 0.08


@pytest.mark.parametrize("heading", HEADINGS)
def test_both_hands_are_at_the_exchange_when_it_is_handed_over(config: RecordConfig, heading: float) -> None:
    right, left, T = _plans(config, heading)
    at = schedule(config.task, config.grasp)
    for plan, ticks in ((right, (at.met, at.given)), (left, (at.taken, at.given))):
        ends = np.cumsum([waypoint.ticks for waypoint in plan.waypoints])
        for waypoint, begin, end in zip(plan.waypoints, (0, *ends), ends, strict=False):
            if ticks[0] <= begin and end <= ticks[1]:
                np.testing.assert_array_equal(waypoint.T_object_in_world, T)
        assert sum(waypoint.ticks for waypoint in plan.waypoints) + plan.settle_ticks == at.total
    # The taking hand is clear of the object until the giving one stands, on its own side, and likewise afterwards.
    before, after = left.waypoints[0].T_object_in_world, right.waypoints[-1].T_object_in_world
    along = np.array((np.cos(heading), np.sin(heading)))
    assert (before - T)[:2, 3] @ along == pytest.approx(0.08)
    assert (after - T)[:2, 3] @ along == pytest.approx(-0.08)
    assert (before - T)[2, 3] == (after - T)[2, 3] == pytest.approx(0.06)


def test_the_hands_hold_in_turn_and_both_for_a_while(config: RecordConfig) -> None:
    right, left = phases(config.task, config.grasp, *config.acting_scene_arms)
    assert kind_of(config.task).phases(config) == (right, left)
    assert kind_of(config.task).ticks(config) == schedule(config.task, config.grasp).total == 188
    assert (right.arm, left.arm) == (1, 0)
    assert right.held.start == right.reached == left.reached == 24
    assert set(right.held) & set(left.held) == set(range(84, 92))


def test_fingers_open_only_while_the_other_hand_holds(config: RecordConfig) -> None:
    right, _, _ = _plans(config, HEADINGS[0])
    give = right.waypoints[right.release]
    begin = schedule(config.task, config.grasp).met + give.fingers_from * give.ticks
    assert begin == pytest.approx(schedule(config.task, config.grasp).taken)


def test_the_wrist_has_no_turn_to_make_where_the_object_turns_with_the_arm(config: RecordConfig) -> None:
    T_base = config.rig.T_base_in_world(0)
    _, _, T = _plans(config, HEADINGS[0])
    turned = T_base @ pose((0, 0, 0), rotation_z(np.pi / 2)) @ inverse(T_base) @ T
    assert wrist_turn(T, turned, T_base) == pytest.approx(0, abs=1e-9)
    assert yaw(turned) - yaw(T) == pytest.approx(np.pi / 2)


@pytest.fixture(scope="module")
def by_friction(make_config: Callable[..., RecordConfig]) -> RecordConfig:
    rig = "yam_station_linear_4310_d405"
    return make_config({("rig",): rig, ("task",): "handover", ("grasp",): "contact", ("arm",): "left"})


def test_by_friction_the_giving_hand_opens_only_once_the_taking_one_has_closed(by_friction: RecordConfig) -> None:
    giving, taking, T = _plans(by_friction, -HEADINGS[0])
    at = schedule(by_friction.task, "contact")
    pressing = {}
    for name, plan in (("giving", giving), ("taking", taking)):
        ends = np.cumsum([waypoint.ticks for waypoint in plan.waypoints])
        pressing[name] = [end for waypoint, end in zip(plan.waypoints, ends, strict=True) if waypoint.grip]
        assert ends[-1] + plan.settle_ticks == at.total
    assert pressing["taking"][0] == pressing["giving"][-1] == at.taken
    assert giving.phases.held.stop == at.taken
    # The hands lean away from each other: either one's fingers point to where the other one is.
    for plan, sign in ((giving, -1), (taking, 1)):
        approach = (T @ inverse(plan.T_object_in_pinch))[:3, 2]
        assert sign * approach[1] > 0.1


def test_either_arm_can_give(by_friction: RecordConfig) -> None:
    assert [arm.side for arm in by_friction.acting_arms] == ["left", "right"]
    assert "pick up the banana with the left arm, hand it to the right arm" in by_friction.task.language_prompt
