"""Where a thing is put into a container: inside it, and on its rim only where nothing else is left."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import cast

import numpy as np

from yamsim_cli.core.geometry.se3 import Array, pose
from yamsim_cli.core.goals.cast import Cast
from yamsim_cli.core.skills.bench import Bench
from yamsim_cli.core.skills.insert import Insert

# A container 0.2 m square and 0.09 m deep, and a can 0.06 m wide and 0.08 m high whose origin is at its middle.
_INTERIOR = np.array([[-0.1, -0.1, 0.004], [0.1, 0.1, 0.09]])
_CAN = np.array([[-0.03, -0.03, -0.04], [0.03, 0.03, 0.04]])
_FLOOR, _RIM = 0.044, 0.13
CAST = Cast({"can": ("can",), "bin": ("bin",)}, {"can": "can", "bin": "bin"})


def _goals(height_at: Callable[[Array], float]) -> list[Array]:
    world = SimpleNamespace(pose=lambda _: pose(), interior=lambda _: _INTERIOR, block=lambda _: _CAN)
    bench = SimpleNamespace(
        world=world,
        half_outline=lambda thing, heading: np.array([0.03, 0.03]),
        height_on=lambda thing, place, onto, heading: height_at(place),
    )
    return Insert(thing="can", into="bin").goals(cast(Bench, bench), CAST, "can")


def test_places_on_what_stands_inside_are_left_out() -> None:
    goals = _goals(lambda place: _RIM if place[0] > 0.01 else _FLOOR)
    assert goals and all(T[2, 3] == _FLOOR for T in goals)


def test_where_there_is_no_room_inside_it_is_put_on_top() -> None:
    goals = _goals(lambda place: _RIM)
    assert goals and all(T[2, 3] == _RIM for T in goals)


def test_half_way_in_is_inside() -> None:
    # Its bottom is 0.04 m below the rim, which is half of its height; and then 0.03 m.
    assert len(_goals(lambda place: 0.09 if place[0] > 0.01 else _FLOOR)) == len(_goals(lambda place: _FLOOR))
    assert len(_goals(lambda place: 0.10 if place[0] > 0.01 else _FLOOR)) < len(_goals(lambda place: _FLOOR))
