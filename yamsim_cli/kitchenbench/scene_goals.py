"""Goals of yamsim tasks for KitchenBench's scenes; docs/kitchenbench.md lists how they differ from its checkers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kitchenbench.sim.blueprint import SceneBlueprint
from kitchenbench.sim.success import (
    CONTACT_TOL_M,
    CONTAIN_FRACTION,
    OPEN_FRACTION,
    SCOOP_TOL_G,
    SEAL_TOL_M,
    TRANSFER_FRACTION,
)

from .goal_kinds import GoalKind
from .lids import LID
from .skill_programs import compartments, fold_limit

_HOLD_SECONDS = 0.5  # s; KitchenBench's checkers require a single state


def goal_data(blueprint: SceneBlueprint) -> dict[str, Any]:
    """Return a scene's goal, as the data of a task's YAML."""
    return {"all": list(_clauses(blueprint)), "for_s": _HOLD_SECONDS}


def _asset_of(blueprint: SceneBlueprint, name: str) -> str:
    return next(item.asset for item in blueprint.objects if item.name == name)


def rack_region(rack: str) -> str:
    """Return the name of the region that a goal uses for a rack."""
    return f"{rack}_box"


def _clauses(blueprint: SceneBlueprint) -> list[Mapping[str, Any]]:
    roles = {role: names[0] for role, names in blueprint.roles.items()}
    wanted = blueprint.success_params
    match blueprint.target_kind:
        case GoalKind.PLACE_ON:
            pair = {"thing": roles["item"], "surface": roles["surface"]}
            if _asset_of(blueprint, roles["surface"]) in ("plate", "bowl"):
                # Short cutlery comes to rest on a plate's floor, 28 mm below its rim. The checker measures from the
                # rim, and accepts 20 mm: it reports success while the cutlery falls.
                return [{"on": pair}]
            return [{"over": {**pair, "gap": CONTACT_TOL_M}}]
        case GoalKind.STACK:
            return [{"piled": {"things": list(blueprint.roles["stack"]), "gap": CONTACT_TOL_M}}]
        case GoalKind.PLACE_IN:
            return [
                {"in": {"thing": roles["item"], "container": rack_region(roles["rack"]), "share": CONTAIN_FRACTION}}
            ]
        case GoalKind.HANDOFF:
            return [{"handed_over": {"thing": roles["item"], "to": str(wanted.get("receiving_arm", "either"))}}]
        case GoalKind.SORT:
            return [
                {"in": {"thing": name, "container": region, "share": CONTAIN_FRACTION}}
                for name, region in compartments(blueprint).items()
            ]
        case GoalKind.FOLD:
            cloth = next(item for item in blueprint.objects if item.name == roles["cloth"])
            return [{"folded_small": {"thing": cloth.name, **fold_limit(blueprint, cloth)}}]
        case GoalKind.OPEN:
            return [{"open": {"thing": roles["container"], "joint": LID, "share": OPEN_FRACTION}}]
        case GoalKind.SEAL:
            return [{"over": {"thing": roles["lid"], "surface": roles["container"], "gap": SEAL_TOL_M}}]
        case GoalKind.POUR:
            least = TRANSFER_FRACTION * float(wanted["total_g"])
            return [{"contains": {"container": roles["vessel"], "pieces_of": roles["source"], "least_g": least}}]
        case GoalKind.SCOOP:
            grams, slack = float(wanted["target_g"]), float(wanted.get("tol_g", SCOOP_TOL_G))
            limits = {"least_g": max(grams - slack, 0.0), "most_g": grams + slack}
            return [{"contains": {"container": roles["container"], "pieces_of": roles["substance"], **limits}}]
    raise LookupError(f"scene {blueprint.scene_id!r}: goals of kind {blueprint.target_kind!r} have no equivalent")
