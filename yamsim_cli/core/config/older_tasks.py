"""Tasks of the kinds `pickplace` and `handover`, as they were written before, as programs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .program_task import PROGRAM

_ROLES = ("object", "target")

# For so long at the end the object has to lie on its target, s.
_HOLDS = 0.25

# Placeholders that have another name now.
_WORDS = {"{preposition}": "{target.preposition}", "{giving}": "{first_arm}", "{taking}": "{second_arm}"}

# What has no counterpart: skills plan heights, ticks and the exchange for themselves.
_GONE = ("heights", "exchange")

# kind -> what those tasks have in common, and steps between picking up and putting down.
_KINDS: Mapping[str, tuple[dict[str, Any], list[dict[str, Any]]]] = {
    "pickplace": ({"rig": "single", "arms": "one", "time_limit_s": 20.0}, []),
    "handover": (
        {"rig": "bimanual", "held_at_the_end": True, "time_limit_s": 40.0},
        [{"handover": {"thing": "object", "to": "second"}}],
    ),
}


#: The kinds of tasks that are upgraded.
OLDER_KINDS = tuple(_KINDS)


def upgrade_task(data: Mapping[str, Any]) -> dict[str, Any]:
    """A task's mapping as one of the kind `program`; one of any other kind than `pickplace` and `handover` as it is.

    It does the same with the same things in the same regions, spoken of in the same words. Not kept: the least distance
    between the two origins, the heights and ticks of the plan, the points of the exchange, and the largest height and
    speed of the object at the end. Keys that such a task never had are kept, so that validation names them.

    Args:
        data: as in a task's file, or as a dataset's config has it, with its objects spelled out.
    """
    kind = data.get("kind")
    if not isinstance(kind, str) or kind not in _KINDS:
        return dict(data)
    common, between = _KINDS[kind]
    old = {key: value for key, value in data.items() if key not in (*_GONE, "kind")}
    objects = {role: old.pop(role) for role in _ROLES if role in old}
    upgraded = {
        "kind": PROGRAM,
        **common,
        "grasps": ["weld", "contact"],
        "things": {role: {"of": item, "named": "object"} for role, item in objects.items()},
        "starts": _starts(old.pop("sampling", {}), second=kind == "handover"),
        "phrasings": {"training": [_worded(old.pop("language_prompt"))] if "language_prompt" in old else []},
        "goal": {"on": _on(old.pop("success", {})), "for_s": _HOLDS},
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
        upgraded["language_task"] = _worded(old.pop("language_task"))
    return upgraded | old


def _starts(box: Mapping[str, Any], *, second: bool) -> dict[str, Any]:
    """Where both start, the target before the other arm if `second`."""
    region = {key: box[key] for key in ("x", "y") if key in box}
    if "clearance" in box:
        region["apart"] = box["clearance"]
    arms = {"object": "first", "target": "second" if second else "first"}
    headings = {role: {"yaw_deg": box[f"{role}_yaw_deg"]} for role in _ROLES if f"{role}_yaw_deg" in box}
    return {role: {"from_arm": arms[role], **region, **headings.get(role, {})} for role in _ROLES}


def _on(success: Mapping[str, Any]) -> dict[str, Any]:
    radius = {"radius": success["threshold"]} if "threshold" in success else {}
    return {"thing": "object", "surface": "target", **radius}


def _worded(text: str) -> str:
    for old, new in _WORDS.items():
        text = text.replace(old, new)
    return text
