"""An object alone before an arm: the result of `pick`, and graspable places."""

from __future__ import annotations

import numpy as np
import pytest

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.objects.object_config import GraspPoint, ObjectConfig
from yamsim_cli.core.expert.skills.planning_context import SkillFailedError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.objects.certify.single_object_pick import reachable_grasp_points, simulate_pick


def load(name: str, locations: Locations) -> ObjectConfig:
    return load_config(ObjectConfig, "objects", name, locations)


def places(item: ObjectConfig) -> tuple[GraspPoint, ...]:
    assert item.grasp is not None and item.grasp.friction is not None
    return item.grasp.friction.points


def test_a_cube_is_held_as_its_config_says(locations: Locations) -> None:
    item = load("cube_red", locations)
    taken = simulate_pick(item, locations)
    assert item.grasp is not None and item.grasp.friction is not None
    assert (taken.opening, taken.force) == (item.grasp.opening, item.grasp.friction.force)
    T_pinch_in_thing = np.linalg.inv(taken.T_thing_in_pinch)
    assert T_pinch_in_thing[:3, 3] == pytest.approx(item.grasp.position, abs=0.003)
    assert T_pinch_in_thing[:3, 2] == pytest.approx((0, 0, -1), abs=0.02)


def test_a_tall_thing_does_not_touch_the_hand_at_the_start(locations: Locations) -> None:
    item = load("kitchen_pasta_box", locations)
    assert simulate_pick(item, locations).force == pytest.approx(20.8)


@pytest.mark.slow
def test_what_is_thinner_than_the_pads_reach_down_is_dropped(locations: Locations) -> None:
    with pytest.raises(SkillFailedError, match="fell out of the right hand"):
        simulate_pick(load("kitchen_dry_pasta", locations), locations)


def test_places_that_no_hand_can_take_are_left_out(locations: Locations) -> None:
    item = load("cube_red", locations)
    first, *_ = places(item)
    # Fingers around a point 2 mm over the table would reach into the table at any tilt; fingers open by 5 mm would
    # reach into the cube.
    in_table = first.model_copy(update={"position": (0.0, 0.0, 0.002)})
    in_cube = first.model_copy(update={"opening": 0.002})
    assert reachable_grasp_points(item.with_grasp_points((in_table, first, in_cube)), locations) == (first,)
    assert reachable_grasp_points(item.with_grasp_points((in_table, in_cube)), locations) == ()


def test_no_grasps_are_proposed_for_a_cabinet(locations: Locations) -> None:
    cabinet = load("drawer_cabinet", locations)
    assert reachable_grasp_points(cabinet, locations) == ()
