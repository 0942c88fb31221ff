"""Upgrades tasks of the former kinds `pickplace` and `handover` to the kind `program`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .program_task import PROGRAM_KIND

_FORMER_ROLES = ("object", "target")

_HOLD_S = 0.25  # s, time for which the goal of an upgraded task has to hold

# Placeholder in the instructions of former kinds -> its present name.
_PLACEHOLDERS = {"{preposition}": "{target.preposition}", "{giving}": "{first_arm}", "{taking}": "{second_arm}"}

# Keys without a counterpart, since skills plan heights and the handover.
_OBSOLETE_KEYS = ("heights", "exchange")

# Former kind -> (keys and values of all its upgraded tasks, skills between pick and place).
_FORMER_TASK_KINDS: Mapping[str, tuple[dict[str, Any], list[dict[str, Any]]]] = {
    "pickplace": ({"rig": "single", "arms": "one", "time_limit_s": 20.0}, []),
    "handover": (
        {"rig": "bimanual", "held_at_the_end": True, "time_limit_s": 40.0},
        [{"handover": {"thing": "object", "to": "second"}}],
    ),
}

OLDER_KINDS = tuple(_FORMER_TASK_KINDS)


def upgrade_task(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return a task of a former kind as the kind `program`; other tasks are returned unchanged.

    Objects, regions and phrasings are kept. Dropped values of the plan are its heights, ticks and handover points.
    Dropped limits are the least distance of the two origins, and the object's largest final height and speed. Unknown
    keys are kept, so that validation reports them.

    Args:
        data: content of a task's file, or of a dataset's config, where objects are mappings.
    """
    kind = data.get("kind")
    if not isinstance(kind, str) or kind not in _FORMER_TASK_KINDS:
        return dict(data)
    common, between = _FORMER_TASK_KINDS[kind]
    old = {key: value for key, value in data.items() if key not in (*_OBSOLETE_KEYS, "kind")}
    objects = {role: old.pop(role) for role in _FORMER_ROLES if role in old}
    upgraded = {
        "kind": PROGRAM_KIND,
        **common,
        "grasps": ["weld", "contact"],
        "things": {role: {"of": item, "named": "object"} for role, item in objects.items()},
        "starts": _start_regions(old.pop("sampling", {}), second=kind == "handover"),
        "phrasings": {
            "training": [_with_new_placeholders(old.pop("language_prompt"))] if "language_prompt" in old else []
        },
        "goal": {"on": _on_predicate(old.pop("success", {})), "for_s": _HOLD_S},
        "expert": [
            {"pick": {"thing": "object", "arm": "first"}},
            *between,
            {"place": {"thing": "object", "on": "target"}},
        ],
        "timing": {
            key: value
            for key, value in old.pop("timing", {}).items()
            if key not in ("ticks_per_waypoint", "grip_ticks")
        },
    }
    if "language_task" in old:
        upgraded["language_task"] = _with_new_placeholders(old.pop("language_task"))
    return upgraded | old


def _start_regions(box: Mapping[str, Any], *, second: bool) -> dict[str, Any]:
    region = {key: box[key] for key in ("x", "y") if key in box}
    if "clearance" in box:
        region["apart"] = box["clearance"]
    arms = {"object": "first", "target": "second" if second else "first"}
    headings = {role: {"yaw_deg": box[f"{role}_yaw_deg"]} for role in _FORMER_ROLES if f"{role}_yaw_deg" in box}
    return {role: {"from_arm": arms[role], **region, **headings.get(role, {})} for role in _FORMER_ROLES}


def _on_predicate(success: Mapping[str, Any]) -> dict[str, Any]:
    radius = {"radius": success["threshold"]} if "threshold" in success else {}
    return {"thing": "object", "surface": "target", **radius}


def _with_new_placeholders(text: str) -> str:
    for old, new in _PLACEHOLDERS.items():
        text = text.replace(old, new)
    return text
