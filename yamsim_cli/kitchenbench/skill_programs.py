"""`build_scene_program`: the expert's skills for a KitchenBench scene, by the kind of its goal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from kitchenbench.sim.blueprint import ASSETS, SceneBlueprint, SceneObject
from kitchenbench.sim.success import FOLD_MAX_HEIGHT_M, FOLD_RATIO_PER_FOLD, SCOOP_TOL_G

from ..core.config.objects.object_config import ObjectConfig
from ..core.config.objects.shapes import CapShape, RackShape
from ..core.expert.skills.handover import Handover
from ..core.expert.skills.pick import Pick
from ..core.expert.skills.place import Place
from ..core.expert.skills.skill import Skill
from ..core.geometry.se3 import Array
from ..kitchen_skills.fold_small import FoldSmall
from ..kitchen_skills.open_lid import OpenLid
from ..kitchen_skills.pour import Pour
from ..kitchen_skills.press_level import PressLevel
from ..kitchen_skills.scoop import Scoop
from ..kitchen_skills.sorting import Sort
from .asset_configs import CRUMPLE_CONDITION, is_folded_in_thirds
from .goal_kinds import GoalKind
from .lids import LID
from .object_poses import T_in_world

_RACK_BOW_CLEARANCE = 0.008  # m, between a dish and the bow at an end of the rack
_STACK_DROP = 0.02  # m, height of release: the fingers around the rim reach below it
_PLATE_DROP = 0.015  # m over a plate, height of cutlery's release: KitchenBench takes the rim as the top
# m, last part of a screw lid's way down to its jar. There, the fingers around the lid are 3 mm beside the neck, and the
# planner keeps 4 mm. From this height, a lid falls and tilts.
_SCREW_LID_UNCHECKED_DESCENT = 0.015
_COMPARTMENT_PREFIX = "compartment_"  # the kind of cutlery follows


def build_scene_program(
    blueprint: SceneBlueprint, items: Mapping[str, ObjectConfig], bases: Sequence[Array]
) -> list[Skill]:
    """Return the skills for a scene's goal, in order. Raise LookupError if no expert exists for its kind.

    `bases` are the positions (2,) of the arms' bases in `world`, m.
    """
    roles = blueprint.roles
    match blueprint.target_kind:
        case GoalKind.PLACE_ON:
            kinds = {item.name: item.asset for item in blueprint.objects}
            drop = _PLATE_DROP if kinds[roles["surface"][0]] == "plate" else 0.0
            return _pick_and_place(roles["item"][0], Place(thing=roles["item"][0], on=roles["surface"][0], drop=drop))
        case GoalKind.PLACE_IN:
            return _pick_and_place(
                roles["item"][0], _slot_placement(blueprint, items, roles["item"][0], roles["rack"][0])
            )
        case GoalKind.HANDOFF:
            return _handover_program(blueprint, roles["item"][0])
        case GoalKind.STACK:
            return _stack_program(blueprint, roles["stack"], bases)
        case GoalKind.SORT:
            return [Sort(into=compartments(blueprint))]
        case GoalKind.FOLD:
            return _fold_program(blueprint, roles["cloth"][0])
        case GoalKind.OPEN:
            return [OpenLid(thing=roles["container"][0], joint=LID)]
        case GoalKind.POUR:
            return [Pour(thing=roles["source"][0], into=roles["vessel"][0])]
        case GoalKind.SCOOP:
            return [_scoop(blueprint)]
        case GoalKind.SEAL:
            lid = roles["lid"][0]
            descent = _SCREW_LID_UNCHECKED_DESCENT if isinstance(items[lid].shape, CapShape) else 0.0
            return _pick_and_place(lid, Place(thing=lid, on=roles["container"][0], unchecked_descent=descent))
    raise LookupError(f"scene {blueprint.scene_id!r}: no expert for goals of kind {blueprint.target_kind!r}")


def compartments(blueprint: SceneBlueprint) -> dict[str, str]:
    """Return object -> name of the compartment of its kind."""
    kinds = {item.name: item.asset for item in blueprint.objects}
    return {name: _COMPARTMENT_PREFIX + kinds[name] for name in blueprint.roles["sortable"]}


def _scoop(blueprint: SceneBlueprint) -> Skill:
    wanted = blueprint.success_params
    return Scoop(
        tool=blueprint.roles["tool"][0],
        source=blueprint.roles["substance"][0],
        into=blueprint.roles["container"][0],
        grams=float(wanted["target_g"]),
        tolerance=float(wanted.get("tol_g", SCOOP_TOL_G)),
    )


def _fold_program(blueprint: SceneBlueprint, cloth: str) -> list[Skill]:
    item = next(one for one in blueprint.objects if one.name == cloth)
    thirds, crumpled = is_folded_in_thirds(blueprint, item), CRUMPLE_CONDITION in blueprint.conditions
    return [FoldSmall(thing=cloth, thirds=thirds, crumpled=crumpled, **fold_limit(blueprint, item))]


def fold_limit(blueprint: SceneBlueprint, item: SceneObject) -> dict[str, float]:
    """Return the largest bounding box of a folded cloth that KitchenBench's checker accepts.

    The dictionary has the key `height`, m, and either `area`, m2, or `share`, of the box's area at the start.
    """
    given = blueprint.success_params
    ratio = FOLD_RATIO_PER_FOLD ** int(float(given.get("fold_count", 1))) * (1 + float(given.get("slack", 0.0)))
    if given.get("baseline") != "nominal":
        return {"height": FOLD_MAX_HEIGHT_M, "share": ratio}
    asset = ASSETS[item.asset]
    return {"height": FOLD_MAX_HEIGHT_M, "area": ratio * asset.footprint_w_cm * asset.footprint_h_cm / 1e4}


def _pick_and_place(thing: str, placing: Skill) -> list[Skill]:
    return [Pick(thing=thing), placing]


def _slot_placement(blueprint: SceneBlueprint, items: Mapping[str, ObjectConfig], item: str, rack: str) -> Skill:
    """Place a dish upright in the required slot, counted from the left, or in the nearest slot between the bows."""
    shape, dish = items[rack].shape, next(thing for thing in blueprint.objects if thing.name == item)
    assert isinstance(shape, RackShape), "a rack is made from sizes"
    slots = (np.arange(shape.slots) - (shape.slots - 1) / 2) * shape.slot_mm / 1000
    room = shape.size_mm[0] / 2000 - _RACK_BOW_CLEARANCE - _width_cm(dish) / 200
    required = slots[min(int(blueprint.conditions.get("slot_index", 1)), len(slots)) - 1]
    fitting = slots[np.abs(slots) <= room]
    x = min(fitting, key=lambda slot: abs(slot - required), default=0.0)
    return Place(thing=item, on=rack, at=(float(x), 0.0))


def _handover_program(blueprint: SceneBlueprint, item: str) -> list[Skill]:
    """Return a pick and a handover. If the scene names a receiver, the other arm picks."""
    height = float(blueprint.conditions.get("handoff_height_cm", 22.0)) / 100
    match str(blueprint.success_params.get("receiving_arm", "either")):
        case "left":
            return [Pick(thing=item, arm="right"), Handover(thing=item, to="left", height=height)]
        case "right":
            return [Pick(thing=item, arm="left"), Handover(thing=item, to="right", height=height)]
    return [Pick(thing=item), Handover(thing=item, to="other", height=height)]


def _stack_program(blueprint: SceneBlueprint, names: Sequence[str], bases: Sequence[Array]) -> list[Skill]:
    """Stack onto the largest object; of equal ones, onto that with the shortest reach."""
    items = {item.name: item for item in blueprint.objects if item.name in names}
    places = {name: T_in_world(item, blueprint)[:2, 3] for name, item in items.items()}

    def longest_reach_of_nearer_arm(below: str) -> float:
        """Return an arm's longest reach, m, if the nearer arm brings each object."""
        paths = ((places[name], places[below]) for name in names if name != below)
        return max(min(max(float(np.linalg.norm(end - base)) for end in path) for base in bases) for path in paths)

    below, *others = sorted(names, key=lambda name: (-_width_cm(items[name]), longest_reach_of_nearer_arm(name)))
    others.sort(key=lambda name: (-_width_cm(items[name]), _distance_between(places, name, below)))
    skills: list[Skill] = []
    for name in others:
        skills += _pick_and_place(name, Place(thing=name, on=below, drop=_STACK_DROP))
        if items[name].asset == "bowl" and _width_cm(items[name]) < _width_cm(items[below]):
            # A bowl falls deep into a larger one, and may lie askew there.
            skills.append(PressLevel(thing=name))
        below = name
    return skills


def _width_cm(item: SceneObject) -> float:
    return item.size_cm or ASSETS[item.asset].footprint_w_cm


def _distance_between(places: dict[str, Array], one: str, other: str) -> float:
    return float(np.linalg.norm(places[one] - places[other]))
