"""Configs of the benchmark's assets: kitchen things and cloth, in the sizes that a scene requires."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from kitchenbench.sim.blueprint import ASSETS, SceneBlueprint, SceneObject

from ..core.config.loader import load_config
from ..core.config.objects.cloth import Cloth, cloth_object
from ..core.config.objects.generated import object_from_shape
from ..core.config.objects.object_config import ObjectConfig
from ..core.config.scene import Table
from ..core.files.resources import Locations
from ..core.geometry.se3 import Array
from ..core.scene.compiled import CompiledScene
from ..core.sim.cloth import crumple

# Asset -> object config. Compartments are parts of the tray, and cloth is in `SHEETS`.
_THINGS = {
    name: f"kitchen_{name}"
    for name in (
        "spoon", "fork", "knife", "plate", "bowl", "cup", "tray", "dish_rack", "utensil", "produce_item",
        "distractor",
    )
}  # fmt: skip

#: The asset whose objects are parts of the tray.
COMPARTMENT = "compartment"

_COURGETTE = 55.0  # mm, width and height of a long produce item; fingers could not hold a tomato of that length
_GREEN = {"stuff": "fruit", "rgba": [0.24, 0.42, 0.16, 1], "specular": 0.3, "shininess": 0.4}

_UNDER_RIM = 0.012  # m, from a cup's rim down to where it is held above the cup that it goes into
_NO_SLOTS = 40.0  # mm of a rack's length that have no slots
_SCALED = ("diameter_mm", "height_mm", "foot_mm", "fillet_mm", "stalk_mm", "mass_g")  # all sizes but the walls

#: The kind of goal whose things are cloth.
FOLD = "fold"
#: Asset -> sheet config of the asset's nominal size.
SHEETS = {"napkin": "soft_napkin", "cloth": "soft_cloth", "dish_towel": "soft_dish_towel"}
#: The condition of a scene with crumpled cloth.
CRUMPLED = "crumple_level"
_CRUMPLED = {"light": 0.2, "moderate": 0.4}  # level -> height and distance of the pull, as shares of half the length

_EDGE = 0.05  # m, of the table around cloth
_FINER = 2  # cells along a side of crumpled cloth for each cell of flat cloth: larger cells stand up in tents
# Points along the side of a towel that is folded in thirds: three cells, four and four. A sheet bends only along lines
# of points, and the inner third has to be the shorter one.
_IN_THIRDS = 12


def object_config_of(
    item: SceneObject, conditions: Mapping[str, Any], locations: Locations, nests: bool = True
) -> ObjectConfig:
    """The config of a blueprint's object, by the object's name.

    Args:
        conditions: of the scene; the rack realizes `slot_width_cm`.
        nests: whether a cup may be put into another one: then it is held just under its rim first.

    Raises:
        LookupError: the asset is not realized.
    """
    if item.asset not in _THINGS:
        raise LookupError(
            f"object {item.name!r}: asset {item.asset!r} is not realized; those are: {', '.join(_THINGS)}"
        )
    ours = load_config(ObjectConfig, "objects", _THINGS[item.asset], locations)
    assert ours.shape is not None, "the kitchen's things are made from sizes"
    shape = _sized(item, ours.shape.model_dump(mode="json", exclude_none=True), conditions)
    data = {"name": item.name, "shape": shape}
    checked = ObjectConfig.model_validate({**ours.model_dump(mode="json", exclude_none=True), **data})
    assert checked.shape is not None
    made = object_from_shape(item.name, checked.shape)
    if item.asset == "cup" and nests:
        made["grasp"] = _at_the_top(made["grasp"], shape)
    return ObjectConfig.model_validate({**data, **made})


def _at_the_top(grasp: dict[str, Any], shape: Mapping[str, Any]) -> dict[str, Any]:
    """The grasp of a cup that goes into another cup by two thirds: just under its rim first."""
    height, opening = shape["height_mm"] / 1000 - _UNDER_RIM, shape["diameter_mm"] / 2000
    friction = grasp["friction"]
    top = [{**point, "position": [0.0, 0.0, height], "opening": opening} for point in friction["points"]]
    return {**grasp, **top[0], "friction": {**friction, "points": [*top, *friction["points"]]}}


def _sized(item: SceneObject, shape: dict[str, Any], conditions: Mapping[str, Any]) -> dict[str, Any]:
    """A shape's plain data with the size that a scene requires; of tools, the length."""
    if item.asset == "dish_rack" and "slot_width_cm" in conditions:
        slot = 10.0 * float(conditions["slot_width_cm"])
        return {**shape, "slot_mm": slot, "slots": int((shape["size_mm"][0] - _NO_SLOTS) // slot)}
    if item.size_cm is None:
        return shape
    size, nominal = 10.0 * item.size_cm, ASSETS[item.asset]
    if item.asset in ("spoon", "fork", "knife", "utensil"):
        width, _, height = shape["size_mm"]
        return {**shape, "size_mm": [width, size, height]}
    if item.asset == "produce_item" and item.size_cm > 1.5 * nominal.footprint_w_cm:
        sides = [_COURGETTE, size, _COURGETTE]
        return {
            "family": "block", "size_mm": sides, "corner_mm": 20, "edge_mm": 10, "materials": {"body": _GREEN}
        }  # fmt: skip
    factor = item.size_cm / nominal.footprint_w_cm
    grown = {key: value * factor for key, value in shape.items() if key in _SCALED}
    if "size_mm" in shape:
        grown["size_mm"] = [value * factor for value in shape["size_mm"]]
    return {**shape, **grown}


def is_folded_in_thirds(blueprint: SceneBlueprint, item: SceneObject) -> bool:
    """Whether a cloth is folded twice, and long enough for thirds."""
    return int(float(blueprint.success_params.get("fold_count", 1))) > 1 and item.asset == "dish_towel"


def cloth_config_of(item: SceneObject, blueprint: SceneBlueprint, locations: Locations) -> ObjectConfig:
    """The config of a blueprint's cloth, by the object's name. `size_cm` is its width; the length is proportional.

    Raises:
        LookupError: the asset is no realized cloth.
    """
    if item.asset not in SHEETS:
        raise LookupError(
            f"object {item.name!r}: asset {item.asset!r} is no cloth that is realized; those are: {', '.join(SHEETS)}"
        )
    ours = load_config(ObjectConfig, "objects", SHEETS[item.asset], locations).cloth
    assert ours is not None, "sheets are cloth"
    nominal = ASSETS[item.asset].footprint_w_cm
    factor = (item.size_cm or nominal) / nominal
    grown: dict[str, Any] = {"size_mm": [side * factor for side in ours.size_mm], "mass_g": ours.mass_g * factor**2}
    if CRUMPLED in blueprint.conditions:
        grown |= {"grid": [_FINER * (count - 1) + 1 for count in ours.grid], "solver": "cg"}
    if is_folded_in_thirds(blueprint, item):
        grown["grid"] = [ours.grid[0], _IN_THIRDS]
    cloth = Cloth.model_validate({**ours.model_dump(mode="json"), **grown})
    data = {"name": item.name, "cloth": cloth.model_dump(mode="json")}
    return ObjectConfig.model_validate({**data, **cloth_object(data)})


def crumpled_start(blueprint: SceneBlueprint, scene: CompiledScene, start: Array, timestep: float) -> Array:
    """MuJoCo's positions (nq,) with the cloths crumpled as the scene requires; a function of the blueprint's values.

    Args:
        start: MuJoCo's positions (nq,) with flat cloths.
    """
    level = blueprint.conditions.get(CRUMPLED)
    if level is None:
        return start
    key = repr(sorted((name, str(value)) for name, value in blueprint.values.items()))
    rng = np.random.default_rng(zlib.crc32(key.encode()))
    for name in scene.cloths:
        start = crumple(scene, start, name, rng, _CRUMPLED[str(level)], timestep)
    return start


def table_for_sheet(table: Table, item: SceneObject, middle: tuple[float, float]) -> Table:
    """A table, enlarged so that a cloth lies flat on it at any angle.

    Args:
        middle: of the cloth, in `world`, m.
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
