"""What the benchmark's assets are here: our own kitchen things, in the sizes that a scene asks for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kitchenbench.sim.blueprint import ASSETS, SceneObject

from ..core.config.loader import load_config
from ..core.config.things.made import made_object
from ..core.config.things.thing import ObjectConfig
from ..core.resources import Locations

# Asset -> our object. Compartments are no things: they are parts of the tray. Cloth is in `linen`.
_THINGS = {
    name: f"kitchen_{name}"
    for name in (
        "spoon", "fork", "knife", "plate", "bowl", "cup", "tray", "dish_rack", "utensil", "produce_item",
        "distractor",
    )
}  # fmt: skip

#: Parts of the tray.
COMPARTMENT = "compartment"

# A tomato as long as a tool could not be held: a long produce item is a courgette, of this width and height, mm.
_COURGETTE = 55.0
_GREEN = {"stuff": "fruit", "rgba": [0.24, 0.42, 0.16, 1], "specular": 0.3, "shininess": 0.4}

# So far under its rim a cup can be held above the one that it is in, m.
_UNDER_RIM = 0.012

# Of a rack's length, so much is no slots, mm.
_NO_SLOTS = 40.0


def thing_of(item: SceneObject, conditions: Mapping[str, Any], where: Locations, nests: bool = True) -> ObjectConfig:
    """What an object of a blueprint is here, by its own name.

    Args:
        conditions: of the scene; `slot_width_cm` is realized by the rack.
        nests: whether a cup may have to go into another thing: then it is held just under its rim first.

    Raises:
        LookupError: there is no such thing here.
    """
    if item.asset not in _THINGS:
        raise LookupError(
            f"object {item.name!r}: asset {item.asset!r} is not realized; those are: {', '.join(_THINGS)}"
        )
    ours = load_config(ObjectConfig, "objects", _THINGS[item.asset], where)
    assert ours.shape is not None, "the kitchen's things are made from sizes"
    shape = _sized(item, ours.shape.model_dump(mode="json", exclude_none=True), conditions)
    data = {"name": item.name, "shape": shape}
    checked = ObjectConfig.model_validate({**ours.model_dump(mode="json", exclude_none=True), **data})
    assert checked.shape is not None
    made = made_object(item.name, checked.shape)
    if item.asset == "cup" and nests:
        made["grasp"] = _at_the_top(made["grasp"], shape)
    return ObjectConfig.model_validate({**data, **made})


def _at_the_top(grasp: dict[str, Any], shape: Mapping[str, Any]) -> dict[str, Any]:
    """How a cup is held that is to go into another one, which takes it in by two thirds: just under its rim first."""
    height, opening = shape["height_mm"] / 1000 - _UNDER_RIM, shape["diameter_mm"] / 2000
    friction = grasp["friction"]
    top = [{**point, "position": [0.0, 0.0, height], "opening": opening} for point in friction["points"]]
    return {**grasp, **top[0], "friction": {**friction, "points": [*top, *friction["points"]]}}


def _sized(item: SceneObject, shape: dict[str, Any], conditions: Mapping[str, Any]) -> dict[str, Any]:
    """A shape's plain data with the size that a scene asks for: of tools, the length."""
    if item.asset == "dish_rack" and "slot_width_cm" in conditions:
        slot = 10.0 * float(conditions["slot_width_cm"])
        return {**shape, "slot_mm": slot, "slots": int((shape["size_mm"][0] - _NO_SLOTS) // slot)}
    if item.size_cm is None:
        return shape
    asked, nominal = 10.0 * item.size_cm, ASSETS[item.asset]
    if item.asset in ("spoon", "fork", "knife", "utensil"):
        width, _, height = shape["size_mm"]
        return {**shape, "size_mm": [width, asked, height]}
    if item.asset == "produce_item" and item.size_cm > 1.5 * nominal.footprint_w_cm:
        size = [_COURGETTE, asked, _COURGETTE]
        return {
            "family": "block", "size_mm": size, "corner_mm": 20, "edge_mm": 10, "materials": {"body": _GREEN}
        }  # fmt: skip
    factor = item.size_cm / nominal.footprint_w_cm
    grown = {key: value * factor for key, value in shape.items() if key in _SCALED}
    if "size_mm" in shape:
        grown["size_mm"] = [value * factor for value in shape["size_mm"]]
    return {**shape, **grown}


# What grows with a thing; walls stay as thick as they are.
_SCALED = ("diameter_mm", "height_mm", "foot_mm", "fillet_mm", "stalk_mm", "mass_g")
