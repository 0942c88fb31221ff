"""Object configs of KitchenBench's assets, in the sizes that a scene requires."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from kitchenbench.sim.blueprint import ASSETS, SceneBlueprint, SceneObject

from ..core.config.loader import load_config
from ..core.config.objects.cloth import Cloth, object_keys_from_cloth
from ..core.config.objects.generated import object_from_shape
from ..core.config.objects.object_config import ObjectConfig
from ..core.config.objects.shapes import CapShape, VesselShape
from ..core.files.resources import Locations
from ..core.geometry.se3 import Array
from ..core.scene.compiled import CompiledScene
from ..core.sim.cloth import crumple_cloth
from .goal_kinds import GoalKind
from .lids import LID_CONFIGS, container_with_ears, lid_between_ears, lidded_container

# Asset -> object config. Compartments are parts of the tray. `CLOTH_CONFIGS` has cloth, and `pasta.py` pasta.
_OBJECT_CONFIGS = {
    name: f"kitchen_{name}"
    for name in (
        "spoon", "fork", "knife", "plate", "bowl", "cup", "tray", "dish_rack", "utensil", "produce_item", "container",
        "distractor", "jar", "bottle", "food_container", "pot", "measuring_cup", "pasta_box",
    )
}  # fmt: skip
# Container -> config of its lid. A pot's lid is round, and derived from the lid of the food container.
_LIDS = {**LID_CONFIGS, "pot": "kitchen_lid"}
_LID_ASSET = "lid"
_POT_RIM = 4.0  # mm, gap between a pot's inner wall and the rim under its lid, which reaches into the pot

#: The asset whose objects are parts of the tray.
COMPARTMENT = "compartment"

_COURGETTE_WIDTH = 55.0  # mm, of long produce; fingers could not hold a tomato of that length
_COURGETTE_BODY = {"stuff": "fruit", "rgba": [0.24, 0.42, 0.16, 1], "specular": 0.3, "shininess": 0.4}

_RIM_GRASP_DEPTH = 0.012  # m below a cup's rim, of the grasp for nesting the cup
# m below the top of a screw lid on the table, of its grasp: at half its height, the pads would be 0.8 mm over the table
_SCREW_LID_GRASP_DEPTH = 0.001
_RACK_LENGTH_WITHOUT_SLOTS = 40.0  # mm of a rack's length without slots
# Keys of shapes, apart from `size_mm`, that grow with an object's size; walls keep their thickness.
_SCALED_KEYS = (
    "diameter_mm", "height_mm", "foot_mm", "fillet_mm", "stalk_mm", "mass_g", "neck_mm", "shoulder_mm", "slope_mm",
)  # fmt: skip

#: Asset -> object config of its cloth in the asset's nominal size.
CLOTH_CONFIGS = {"napkin": "soft_napkin", "cloth": "soft_cloth", "dish_towel": "soft_dish_towel"}
#: The condition of a scene that states how much its cloth is crumpled.
CRUMPLE_CONDITION = "crumple_level"
# Level of `CRUMPLE_CONDITION` -> height and distance of the pull that crumples a cloth, as shares of half its length.
_CRUMPLE_SHARES = {"light": 0.2, "moderate": 0.4}
# Cells of a crumpled cloth per cell of a flat one, along a side: larger cells stand up like tents.
_CRUMPLED_GRID_REFINEMENT = 2
# Points along the side of a towel that is folded in thirds: three cells, four and four. A sheet bends only along lines
# of points, and the inner third has to be the shorter one.
_FOLD_IN_THIRDS_POINTS = 12


def object_config_of(
    item: SceneObject,
    conditions: Mapping[str, Any],
    locations: Locations,
    nests: bool = True,
    is_stacked: bool = False,
) -> ObjectConfig:
    """Return the config of a blueprint's object. Raise LookupError if none exists for the asset.

    `conditions` of the scene may have `slot_width_cm` of the rack. With `nests`, a cup is grasped just under its rim
    first. A bowl that `is_stacked` is grasped by its wall: fingers around it would touch the bowl into which it goes.
    """
    if item.asset not in _OBJECT_CONFIGS:
        raise LookupError(
            f"object {item.name!r}: asset {item.asset!r} is not supported; valid: {', '.join(_OBJECT_CONFIGS)}"
        )
    base = load_config(ObjectConfig, "objects", _OBJECT_CONFIGS[item.asset], locations).with_name(item.name)
    shape = _scaled_shape(item, shape_data(base), conditions)
    made = with_shape(base, shape, by_wall=item.asset == "bowl" and is_stacked)
    return _grasped_under_rim(made) if item.asset == "cup" and nests else made


def container_config_of(item: SceneObject, blueprint: SceneBlueprint, locations: Locations) -> ObjectConfig:
    """Return the config of an object in a scene with lids: a container with its lid on, an open one, or a lid alone.

    Raise LookupError if yamsim has none for the asset.
    """
    if blueprint.target_kind == GoalKind.OPEN:
        if item.asset not in LID_CONFIGS:
            raise LookupError(
                f"object {item.name!r}: asset {item.asset!r} has no lid that opens; valid: {', '.join(LID_CONFIGS)}"
            )
        base = object_config_of(item, blueprint.conditions, locations)
        lid = _lid_config_of(item, base, locations)
        if item.asset == "food_container":
            base = with_shape(base, container_with_ears(shape_data(base)))
            lid = with_shape(lid, lid_between_ears(shape_data(lid)))
        return lidded_container(base, item.asset, lid, blueprint)
    if item.asset != _LID_ASSET:
        return object_config_of(item, blueprint.conditions, locations)
    container = next(one for one in blueprint.objects if one.name == item.parent)
    base = object_config_of(container, blueprint.conditions, locations)
    lid = _lid_config_of(container, base, locations).with_name(item.name)
    return _grasped_near_top(lid) if isinstance(lid.shape, CapShape) else lid


def _lid_config_of(container: SceneObject, base: ObjectConfig, locations: Locations) -> ObjectConfig:
    """Return the lid of a container of the config `base`, which has the sizes that the scene requires."""
    lid = load_config(ObjectConfig, "objects", _LIDS[container.asset], locations)
    data = shape_data(lid)
    if container.asset == "pot":
        assert isinstance(base.shape, VesselShape)
        across = base.shape.diameter_mm
        rim = base.shape.wall_mm + _POT_RIM
        data |= {"size_mm": [across, across, data["size_mm"][2]], "corner_mm": across / 2 - 0.5, "inset_mm": rim}
        return with_shape(lid, data)
    nominal = ASSETS[container.asset].footprint_w_cm
    return with_shape(lid, {**data, **_scaled_sizes(data, (container.size_cm or nominal) / nominal)})


def _grasped_near_top(lid: ObjectConfig) -> ObjectConfig:
    """Return a screw lid that lies on the table, with its grasp points just below its top."""
    assert isinstance(lid.shape, CapShape)
    data = lid.model_dump(mode="json", exclude_none=True)
    friction, at = data["grasp"]["friction"], [0.0, 0.0, lid.shape.height_mm / 1000 - _SCREW_LID_GRASP_DEPTH]
    points = [{**point, "position": at} for point in friction["points"]]
    grasp = {**data["grasp"], "position": at, "friction": {**friction, "points": points}}
    return ObjectConfig.model_validate({**data, "grasp": grasp})


def _grasped_under_rim(cup: ObjectConfig) -> ObjectConfig:
    """Return a cup that is grasped just under its rim first, as it goes into another cup by two thirds."""
    assert isinstance(cup.shape, VesselShape)
    data = cup.model_dump(mode="json", exclude_none=True)
    at, opening = [0.0, 0.0, cup.shape.height_mm / 1000 - _RIM_GRASP_DEPTH], cup.shape.diameter_mm / 2000
    friction = data["grasp"]["friction"]
    top = [{**point, "position": at, "opening": opening} for point in friction["points"]]
    grasp = {**data["grasp"], **top[0], "friction": {**friction, "points": [*top, *friction["points"]]}}
    return ObjectConfig.model_validate({**data, "grasp": grasp})


def shape_data(item: ObjectConfig) -> dict[str, Any]:
    """Return the data of the shape from which an object is made."""
    assert item.shape is not None, "the kitchen's things are made from sizes"
    return item.shape.model_dump(mode="json", exclude_none=True)


def with_shape(item: ObjectConfig, shape: Mapping[str, Any], *, by_wall: bool = False) -> ObjectConfig:
    """Return an object of the same name that is made from other sizes; `by_wall` as in `object_from_shape`."""
    data = {"name": item.name, "shape": dict(shape)}
    checked = ObjectConfig.model_validate({**item.model_dump(mode="json", exclude_none=True), **data})
    assert checked.shape is not None
    return ObjectConfig.model_validate({**data, **object_from_shape(item.name, checked.shape, by_wall=by_wall)})


def _scaled_sizes(shape: Mapping[str, Any], factor: float) -> dict[str, Any]:
    grown = {key: value * factor for key, value in shape.items() if key in _SCALED_KEYS}
    if "size_mm" in shape:
        grown["size_mm"] = [value * factor for value in shape["size_mm"]]
    return grown


def _scaled_shape(item: SceneObject, shape: dict[str, Any], conditions: Mapping[str, Any]) -> dict[str, Any]:
    """Return a shape's data in the size that a scene requires; for tools, the size is the length."""
    if item.asset == "dish_rack" and "slot_width_cm" in conditions:
        slot = 10.0 * float(conditions["slot_width_cm"])
        return {**shape, "slot_mm": slot, "slots": int((shape["size_mm"][0] - _RACK_LENGTH_WITHOUT_SLOTS) // slot)}
    if item.size_cm is None:
        return shape
    size, nominal = 10.0 * item.size_cm, ASSETS[item.asset]
    if item.asset in ("spoon", "fork", "knife", "utensil"):
        width, _, height = shape["size_mm"]
        return {**shape, "size_mm": [width, size, height]}
    if item.asset == "produce_item" and item.size_cm > 1.5 * nominal.footprint_w_cm:
        sides = [_COURGETTE_WIDTH, size, _COURGETTE_WIDTH]
        return {
            "family": "block", "size_mm": sides, "corner_mm": 20, "edge_mm": 10, "materials": {"body": _COURGETTE_BODY}
        }  # fmt: skip
    return {**shape, **_scaled_sizes(shape, item.size_cm / nominal.footprint_w_cm)}


def is_folded_in_thirds(blueprint: SceneBlueprint, item: SceneObject) -> bool:
    """Whether a cloth is folded twice, and long enough for thirds."""
    return int(float(blueprint.success_params.get("fold_count", 1))) > 1 and item.asset == "dish_towel"


def cloth_config_of(item: SceneObject, blueprint: SceneBlueprint, locations: Locations) -> ObjectConfig:
    """Return the config of a blueprint's cloth. `size_cm` is the width; the length is proportional.

    Raise LookupError if none exists for the asset.
    """
    if item.asset not in CLOTH_CONFIGS:
        raise LookupError(
            f"object {item.name!r}: asset {item.asset!r} is not a supported cloth; valid: {', '.join(CLOTH_CONFIGS)}"
        )
    base = load_config(ObjectConfig, "objects", CLOTH_CONFIGS[item.asset], locations).cloth
    assert base is not None, "`CLOTH_CONFIGS` has cloth only"
    nominal = ASSETS[item.asset].footprint_w_cm
    factor = (item.size_cm or nominal) / nominal
    grown: dict[str, Any] = {
        "size_mm": [side * factor for side in base.size_mm],
        "mass_g": base.mass_g * factor**2,
        "release": "clear",
    }
    if CRUMPLE_CONDITION in blueprint.conditions:
        grown |= {"grid": [_CRUMPLED_GRID_REFINEMENT * (count - 1) + 1 for count in base.grid], "solver": "cg"}
    if is_folded_in_thirds(blueprint, item):
        grown["grid"] = [base.grid[0], _FOLD_IN_THIRDS_POINTS]
    cloth = Cloth.model_validate({**base.model_dump(mode="json"), **grown})
    data = {"name": item.name, "cloth": cloth.model_dump(mode="json")}
    return ObjectConfig.model_validate({**data, **object_keys_from_cloth(data)})


def start_extras(blueprint: SceneBlueprint) -> dict[str, Any]:
    """Return additional data of the start of a scene's object: how much a cloth is crumpled."""
    level = blueprint.conditions.get(CRUMPLE_CONDITION)
    return {} if level is None else {"crumpled": [_CRUMPLE_SHARES[str(level)]] * 2}


def crumpled_start(blueprint: SceneBlueprint, scene: CompiledScene, start: Array, timestep: float) -> Array:
    """Return MuJoCo's positions (nq,) with the flat cloths of `start` crumpled, always the same for a blueprint."""
    level = blueprint.conditions.get(CRUMPLE_CONDITION)
    if level is None:
        return start
    key = repr(sorted((name, str(value)) for name, value in blueprint.values.items()))
    rng = np.random.default_rng(zlib.crc32(key.encode()))
    for name in scene.cloths:
        start = crumple_cloth(scene, start, name, rng, _CRUMPLE_SHARES[str(level)], timestep)
    return start
