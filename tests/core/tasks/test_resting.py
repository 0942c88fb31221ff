"""How high a thing is put onto, or into, another."""

from __future__ import annotations

import pytest
from yamsim_cli.core.tasks.resting import resting_height

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.things.thing import ObjectConfig
from yamsim_cli.core.resources import Locations


def thing(name: str, locations: Locations) -> ObjectConfig:
    return load_config(ObjectConfig, "objects", name, locations)


@pytest.mark.parametrize(
    ("item", "target", "height"),
    [
        # A bowl 80 mm high and 160 mm wide: fruit lies at its bottom, cutlery of 180 to 210 mm on its rim.
        ("kitchen_produce_item", "kitchen_bowl", 0.0024),
        ("kitchen_spoon", "kitchen_bowl", 0.077),
        ("kitchen_knife", "kitchen_bowl", 0.079),
        # A cup's foot, 66 mm wide, goes down to the plate's floor.
        ("kitchen_cup", "kitchen_plate", 0.0013),
        # Without walls there is nothing in the way.
        ("kitchen_spoon", "kitchen_napkin", 0.010),
    ],
)
def test_what_is_longer_than_a_vessel_is_wide_lies_on_its_rim(
    item: str, target: str, height: float, locations: Locations
) -> None:
    assert resting_height(thing(item, locations), thing(target, locations)) == pytest.approx(height, abs=0.002)


def test_in_a_scanned_bowl_things_are_put_where_they_always_were(locations: Locations) -> None:
    banana, bowl = thing("011_banana", locations), thing("024_bowl", locations)
    assert resting_height(banana, bowl) == bowl.support_height + banana.rest_height
