"""The benchmark's cloth: sheets that bend, and the table that they lie flat on."""

from __future__ import annotations

import math
import zlib
from typing import Any

import numpy as np
from kitchenbench.sim.blueprint import ASSETS, SceneBlueprint, SceneObject

from ..core.config.loader import load_config
from ..core.config.scene import Table
from ..core.config.things.cloth import Cloth, cloth_object
from ..core.config.things.thing import ObjectConfig
from ..core.geometry.se3 import Array
from ..core.resources import Locations
from ..core.scene.compiled import CompiledScene
from ..core.sim.crumple import crumpled

#: The kind of goal whose things are cloth.
FOLD = "fold"

#: Asset -> our sheet of its nominal size.
SHEETS = {"napkin": "soft_napkin", "cloth": "soft_cloth", "dish_towel": "soft_dish_towel"}

#: What a scene says of a cloth that is crumpled, and how high and far it was taken for each level, of its half length.
CRUMPLED = "crumple_level"
_CRUMPLED = {"light": 0.2, "moderate": 0.4}

# The table goes on for so far around cloth, m.
_EDGE = 0.05

# Crumpled cloth has so many cells along a side for one of cloth that lies flat: larger ones stand up in tents.
_FINER = 2

# What is folded in thirds has so many points along that side: three cells, four and four. A sheet bends along lines of
# points alone, and the third that comes inside has to be the shorter one.
_IN_THIRDS = 12


def in_thirds(blueprint: SceneBlueprint, item: SceneObject) -> bool:
    """Whether a cloth is to be folded twice, and long enough for thirds."""
    return int(float(blueprint.success_params.get("fold_count", 1))) > 1 and item.asset == "dish_towel"


def sheet_of(item: SceneObject, blueprint: SceneBlueprint, where: Locations) -> ObjectConfig:
    """What a cloth of a blueprint is here, by its own name: `size_cm` is its width, and its length grows with it.

    Raises:
        LookupError: there is no such cloth here.
    """
    if item.asset not in SHEETS:
        raise LookupError(
            f"object {item.name!r}: asset {item.asset!r} is no cloth that is realized; those are: {', '.join(SHEETS)}"
        )
    ours = load_config(ObjectConfig, "objects", SHEETS[item.asset], where).cloth
    assert ours is not None, "sheets are cloth"
    nominal = ASSETS[item.asset].footprint_w_cm
    factor = (item.size_cm or nominal) / nominal
    grown: dict[str, Any] = {"size_mm": [side * factor for side in ours.size_mm], "mass_g": ours.mass_g * factor**2}
    if CRUMPLED in blueprint.conditions:
        grown |= {"grid": [_FINER * (count - 1) + 1 for count in ours.grid], "solver": "cg"}
    if in_thirds(blueprint, item):
        grown["grid"] = [ours.grid[0], _IN_THIRDS]
    cloth = Cloth.model_validate({**ours.model_dump(mode="json"), **grown})
    data = {"name": item.name, "cloth": cloth.model_dump(mode="json")}
    return ObjectConfig.model_validate({**data, **cloth_object(data)})


def crumpled_start(blueprint: SceneBlueprint, scene: CompiledScene, start: Array, timestep: float) -> Array:
    """MuJoCo's positions (nq,) with the cloths of a scene crumpled as it says: of the same values, always the same way.

    Args:
        start: the same with the cloths flat.
    """
    level = blueprint.conditions.get(CRUMPLED)
    if level is None:
        return start
    said = repr(sorted((name, str(value)) for name, value in blueprint.values.items()))
    rng = np.random.default_rng(zlib.crc32(said.encode()))
    for name in scene.cloths:
        start = crumpled(scene, start, name, rng, _CRUMPLED[str(level)], timestep)
    return start


def laid(table: Table, item: SceneObject, middle: tuple[float, float]) -> Table:
    """A table on which a cloth lies flat however it is turned; larger than a given one where that ends before.

    Args:
        middle: where the cloth's middle lies in `world`, m.
    """
    asset = ASSETS[item.asset]
    factor = (item.size_cm or asset.footprint_w_cm) / asset.footprint_w_cm
    reach = math.hypot(asset.footprint_w_cm, asset.footprint_h_cm) * factor / 200 + _EDGE
    low, high = [], []
    for k in (0, 1):
        low.append(min(table.position[k] - table.half_size[k], middle[k] - reach))
        high.append(max(table.position[k] + table.half_size[k], middle[k] + reach))
    half = ((high[0] - low[0]) / 2, (high[1] - low[1]) / 2, table.half_size[2])
    centre = ((high[0] + low[0]) / 2, (high[1] + low[1]) / 2, table.position[2])
    return table.model_copy(update={"position": centre, "half_size": half})
