"""What an expert does in a scene of the benchmark: skills, by the kind of its goal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from kitchenbench.sim.blueprint import ASSETS, SceneBlueprint, SceneObject

from ..core.config.things.shapes import RackShape
from ..core.config.things.thing import ObjectConfig
from ..core.geometry.se3 import Array
from ..core.skills.base import Skill
from ..core.skills.handover import Handover
from ..core.skills.pick import Pick
from ..core.skills.place import Place
from .folding import FoldSmall, asked_area
from .linen import CRUMPLED, in_thirds
from .places import T_in_world
from .sorting import Sort

# Between a dish and the bow at an end of the rack, so much is left free, m.
_BOW = 0.008
# A thing that is stacked falls so far: fingers around its rim are lower than it, m.
_DROP = 0.02
# Cutlery is let go so high over a plate, m: about as high as its rim, which is what the benchmark calls its top.
_LET_FALL = 0.015
# Before the kind of cutlery that a compartment is for.
_FOR = "compartment_"


def program_of(blueprint: SceneBlueprint, items: Mapping[str, ObjectConfig], bases: Sequence[Array]) -> list[Skill]:
    """The skills that are to bring a scene to its goal, in order.

    Args:
        items: what the blueprint's objects are here, by their names.
        bases: where the arms stand (2,), in `world`, m.

    Raises:
        LookupError: there is no expert for goals of its kind.
    """
    roles = blueprint.roles
    match blueprint.target_kind:
        case "place_on":
            kinds = {item.name: item.asset for item in blueprint.objects}
            drop = _LET_FALL if kinds[roles["surface"][0]] == "plate" else 0.0
            return _put(roles["item"][0], Place(thing=roles["item"][0], on=roles["surface"][0], drop=drop))
        case "place_in":
            return _put(roles["item"][0], _in_its_slot(blueprint, items, roles["item"][0], roles["rack"][0]))
        case "handoff":
            return _handed_over(blueprint, roles["item"][0])
        case "stack":
            return _stacked(blueprint, roles["stack"], bases)
        case "sort":
            into = {name.removeprefix(_FOR): name for name in roles["compartment"]}
            return [Sort(things="sortable", into=into)]
        case "fold":
            return _folded(blueprint, items, roles["cloth"][0])
    raise LookupError(f"scene {blueprint.scene_id!r}: no expert for goals of kind {blueprint.target_kind!r}")


def _folded(blueprint: SceneBlueprint, items: Mapping[str, ObjectConfig], cloth: str) -> list[Skill]:
    sheet = items[cloth].cloth
    assert sheet is not None, "folds are of cloth"
    item = next(one for one in blueprint.objects if one.name == cloth)
    asked, thirds = asked_area(blueprint, item, sheet), in_thirds(blueprint, item)
    return [FoldSmall(thing=cloth, area=asked, thirds=thirds, crumpled=CRUMPLED in blueprint.conditions)]


def _put(thing: str, placing: Skill) -> list[Skill]:
    return [Pick(thing=thing), placing]


def _in_its_slot(blueprint: SceneBlueprint, items: Mapping[str, ObjectConfig], item: str, rack: str) -> Skill:
    """Upright over the middle of the slot that a scene asks for, or of the nearest one where it fits between the bows.
    Slots are counted from the left.
    """
    shape, dish = items[rack].shape, next(thing for thing in blueprint.objects if thing.name == item)
    assert isinstance(shape, RackShape), "a rack is made from sizes"
    slots = (np.arange(shape.slots) - (shape.slots - 1) / 2) * shape.slot_mm / 1000
    room = shape.size_mm[0] / 2000 - _BOW - _width(dish) / 200
    asked = slots[min(int(blueprint.conditions.get("slot_index", 1)), len(slots)) - 1]
    fitting = slots[np.abs(slots) <= room]
    x = min(fitting, key=lambda slot: abs(slot - asked), default=0.0)
    return Place(thing=item, on=rack, at=(float(x), 0.0))


def _handed_over(blueprint: SceneBlueprint, item: str) -> list[Skill]:
    """By the arm that does not receive it, where the scene says which one does."""
    height = float(blueprint.conditions.get("handoff_height_cm", 22.0)) / 100
    match str(blueprint.success_params.get("receiving_arm", "either")):
        case "left":
            return [Pick(thing=item, arm="right"), Handover(thing=item, to="left", height=height)]
        case "right":
            return [Pick(thing=item, arm="left"), Handover(thing=item, to="right", height=height)]
    return [Pick(thing=item), Handover(thing=item, to="other", height=height)]


def _stacked(blueprint: SceneBlueprint, names: Sequence[str], bases: Sequence[Array]) -> list[Skill]:
    """Onto the largest; of equal ones, onto the one for which arms have to reach least far. The larger come first."""
    items = {item.name: item for item in blueprint.objects if item.name in names}
    places = {name: T_in_world(item, blueprint)[:2, 3] for name, item in items.items()}

    def farthest(below: str) -> float:
        """How far an arm has to reach at most, where each thing is brought by the one that suits it."""
        ways = ((places[name], places[below]) for name in names if name != below)
        return max(min(max(float(np.linalg.norm(end - base)) for end in way) for base in bases) for way in ways)

    below, *others = sorted(names, key=lambda name: (-_width(items[name]), farthest(name)))
    others.sort(key=lambda name: (-_width(items[name]), _apart(places, name, below)))
    skills: list[Skill] = []
    for name in others:
        skills += _put(name, Place(thing=name, on=below, drop=_DROP))
        below = name
    return skills


def _width(item: SceneObject) -> float:
    return item.size_cm or ASSETS[item.asset].footprint_w_cm


def _apart(places: dict[str, Array], one: str, other: str) -> float:
    return float(np.linalg.norm(places[one] - places[other]))
