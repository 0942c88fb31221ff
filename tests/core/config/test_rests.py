"""Which things a hand may put down otherwise than upright."""

from __future__ import annotations

import pytest

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.things.thing import ObjectConfig
from yamsim_cli.core.resources import Locations


@pytest.mark.parametrize(
    ("name", "any_way"),
    [
        ("cube_red", True),
        ("005_tomato_soup_can", True),
        ("011_banana", True),
        ("025_mug", False),
        ("kitchen_cup", False),
        ("kitchen_bottle", False),
        ("024_bowl", False),
        ("drawer_cabinet", False),
        ("soft_napkin", False),
    ],
)
def test_solid_things_may_rest_in_any_way(name: str, any_way: bool, locations: Locations) -> None:
    item = load_config(ObjectConfig, "objects", name, locations)
    assert item.rests_any_way is any_way
    assert item.model_copy(update={"rests": "any"}).rests_any_way
    assert not item.model_copy(update={"rests": "upright"}).rests_any_way
    assert "rests" not in item.model_dump()
