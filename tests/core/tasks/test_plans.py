from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from yamsim_cli.core.tasks.pickplace import sample_layout
from yamsim_cli.core.tasks.plans import Hold, grasp_points, make_plan, phases, phases_of, points_for, ticks

from yamsim_cli.core.config.recording import GraspKind, RecordConfig
from yamsim_cli.core.geometry.se3 import inverse, pose, rotation_z, tilt
from yamsim_cli.core.types import Layout, Phases, Plan

BASE = pose((0.1, -0.2, 0.0), rotation_z(0.3))


@pytest.fixture(scope="module")
def layout(config: RecordConfig) -> Layout:
    layout = sample_layout(config, np.random.default_rng(5))
    assert layout is not None
    return layout


def _plan(
    config: RecordConfig, layout: Layout, grasp: GraspKind = "weld", flipped: bool = False, lean: float = 0.0
) -> Plan:
    hold = Hold(grasp_points(config.task, grasp)[0], flipped, lean)
    return make_plan(config.task, grasp, layout, BASE, hold)


@pytest.mark.parametrize("grasp", ["weld", "contact"])
def test_plan_carries_the_object_not_the_hand_over_the_plate(
    config: RecordConfig, layout: Layout, grasp: GraspKind
) -> None:
    plan = _plan(config, layout, grasp)
    extra = {"weld": ([], []), "contact": (["close"], ["open"])}[grasp]
    names = ["pre-grasp", "grasp", *extra[0], "lift", "arc-top", "pre-place", "place", *extra[1], "retract"]
    assert [waypoint.name for waypoint in plan.waypoints] == names
    grasped, place = plan.waypoints[plan.grasp], plan.waypoints[plan.release]
    assert (grasped.name, place.name) == ("grasp", "place")
    np.testing.assert_allclose(grasped.T_object_in_world, layout.T_in_world["banana"])
    np.testing.assert_allclose(place.T_object_in_world[:2, 3], layout.T_in_world["plate"][:2, 3])
    # Held upright, a finger's breadth above where it will lie.
    np.testing.assert_allclose(place.T_object_in_world[2, :3], (0, 0, 1), atol=1e-12)
    rest = layout.T_in_world["plate"][2, 3] + config.task.target.support_height + config.task.object.rest_height
    assert place.T_object_in_world[2, 3] - rest == pytest.approx(config.task.heights.release)


def test_the_two_ways_round_take_the_object_from_opposite_sides(config: RecordConfig, layout: Layout) -> None:
    one, other = (_plan(config, layout, flipped=flipped) for flipped in (False, True))
    # Held poses differ by half a turn about the approach direction.
    half_turn = one.T_object_in_pinch[:3, :3] @ other.T_object_in_pinch[:3, :3].T
    np.testing.assert_allclose(half_turn, rotation_z(np.pi), atol=1e-12)


@pytest.mark.parametrize("flipped", [False, True])
def test_a_hand_that_leans_points_away_from_the_base_at_the_grasp_and_at_the_place(
    config: RecordConfig, layout: Layout, flipped: bool
) -> None:
    plan = _plan(config, layout, "contact", flipped, lean=0.4)
    for index in (plan.grasp, plan.release):
        T_object = plan.waypoints[index].T_object_in_world
        T_pinch = T_object @ inverse(plan.T_object_in_pinch)
        assert np.pi - tilt(T_pinch[:3, :3]) == pytest.approx(0.4)
        x, y = (inverse(BASE) @ T_object)[:2, 3]
        outwards = BASE[:3, :3] @ np.array([x, y, 0]) / np.hypot(x, y)
        np.testing.assert_allclose(T_pinch[:3, 2], np.sin(0.4) * outwards - (0, 0, np.cos(0.4)), atol=1e-9)
    # About the same point of the object.
    upright = _plan(config, layout, "contact", flipped)
    np.testing.assert_allclose(inverse(plan.T_object_in_pinch)[:3, 3], inverse(upright.T_object_in_pinch)[:3, 3])


@pytest.mark.parametrize("yaw_deg", [0, 100, -40])
def test_a_bowl_is_taken_by_the_near_rim_along_its_wall(make_config: Callable[..., RecordConfig], yaw_deg: int) -> None:
    config = make_config(
        {("task", "object"): "kitchen_bowl", ("task", "target"): "kitchen_plate", ("rig",): "single_linear",
         ("grasp",): "contact"}
    )  # fmt: skip
    T_bowl = BASE @ pose((0.4, 0.1, 0.0), rotation_z(np.radians(yaw_deg)))
    bowl_and_plate = Layout({"bowl": T_bowl, "plate": BASE @ pose((0.5, -0.2, 0.0))})
    points = points_for(config.task, "contact", bowl_and_plate, BASE)
    assert sorted(points, key=str) == sorted(grasp_points(config.task, "contact"), key=str)
    point = points[0]
    plan = make_plan(config.task, "contact", bowl_and_plate, BASE, Hold(point, flipped=False))
    T_pinch = T_bowl @ inverse(plan.T_object_in_pinch)
    # As near as one of twelve places can be.
    nearest = np.hypot(0.4, 0.1) - np.hypot(*point.position[:2]) * np.cos(np.radians(16))
    assert np.hypot(*(inverse(BASE) @ T_pinch)[:2, 3]) <= nearest
    # The fingers close across the wall: it rises outwards by the tilt, and goes round the bowl's axis.
    radial = (T_pinch[:3, 3] - T_bowl[:3, 3]) * (1, 1, 0)
    radial /= np.linalg.norm(radial)
    assert point.tilt_deg is not None
    tilted = np.radians(point.tilt_deg)
    across = np.cos(tilted) * radial - np.sin(tilted) * np.array([0, 0, 1])
    assert abs(T_pinch[:3, 1] @ across) == pytest.approx(1, abs=1e-6)
    # The hand comes the way that it points.
    by_name = {waypoint.name: waypoint.T_object_in_world for waypoint in plan.waypoints}
    way = by_name["grasp"][:3, 3] - by_name["pre-grasp"][:3, 3]
    np.testing.assert_allclose(way, config.task.heights.approach * T_pinch[:3, 2], atol=1e-9)


def test_a_weld_plan_keeps_its_timing(config: RecordConfig, layout: Layout) -> None:
    plan = _plan(config, layout)
    assert [waypoint.ticks for waypoint in plan.waypoints] == [12] * 7
    assert (plan.phases.reached, plan.phases.held) == (24, range(24, 72))
    assert {waypoint.grip for waypoint in plan.waypoints} == {0.0}


def test_a_friction_plan_stops_to_close_and_to_open(config: RecordConfig, layout: Layout) -> None:
    plan = _plan(config, layout, "contact")
    assert (plan.phases.reached, plan.phases.held) == (24, range(32, 80))
    by_name = {waypoint.name: waypoint for waypoint in plan.waypoints}
    for still, before in (("close", "grasp"), ("open", "place")):
        np.testing.assert_array_equal(by_name[still].T_object_in_world, by_name[before].T_object_in_world)
        assert (by_name[still].ticks, by_name[still].stop) == (8, True)
    grips = [waypoint.grip for waypoint in plan.waypoints]
    assert grips == [0, 0, 15, 15, 15, 15, 15, 0, 0]
    openings = [waypoint.gripper for waypoint in plan.waypoints]
    assert openings == pytest.approx([0.0281] * 2 + [0.0181] * 5 + [0.0281] * 2)


@pytest.mark.parametrize("grasp", ["weld", "contact"])
def test_phases_follow_from_the_config_alone(
    make_config: Callable[..., RecordConfig], layout: Layout, grasp: GraspKind
) -> None:
    """An episode's actions can be judged again without its plan."""
    config = make_config({("task", "timing", "ticks_per_waypoint"): 10, ("task", "timing", "grip_ticks"): 3})
    plan = _plan(config, layout, grasp)
    ends = np.cumsum([waypoint.ticks for waypoint in plan.waypoints])
    names = [waypoint.name for waypoint in plan.waypoints]
    held_from = ends[names.index("grasp" if grasp == "weld" else "close")]
    assert phases(config.task, grasp) == plan.phases
    assert plan.phases.reached == ends[plan.grasp]
    assert plan.phases.held == range(held_from, ends[plan.release])
    assert ticks(config.task, grasp) == ends[-1] + config.task.timing.settle_ticks


def test_without_a_plan_the_weld_tells_when_the_object_is_in_hand() -> None:
    assert phases_of(np.array([[False, False, True, True, False, True, False]]).T) == (Phases(2, range(2, 6)),)
    assert phases_of(np.zeros((5, 1), bool)) == (Phases(5, range(0)),)
    both = np.array([(False, True), (True, True), (True, False), (False, False)])
    assert phases_of(both) == (Phases(1, range(1, 3), 0), Phases(0, range(2), 1))
