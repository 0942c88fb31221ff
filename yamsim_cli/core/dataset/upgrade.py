"""Upgrades the records and configs of older datasets to the present format when they are opened.

`docs/format.md` lists what older formats left out. The functions are pure, and leave faults to the validation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

# Absent if nothing varies.
_RANDOMIZATION_DEFAULTS: Mapping[str, Any] = {
    **dict.fromkeys(("headlight", "lens_deg", "camera", "table", "floor", "noise", "salt_pepper")),
    **{key: {} for key in ("mass", "friction", "looks", "distractors")},
    **{key: [] for key in ("lights", "arm_dynamics")},
}
_OUTCOME_DEFAULTS: Mapping[str, Any] = {"margins": None, "measures": [], "recoveries": []}
_EPISODE_DEFAULTS: Mapping[str, Any] = {
    "truth": False,
    "arms": 1,
    "drives": 7,
    "joint_actions": False,
    "joints": {},
    "cloths": {},
    "meshes": None,
}
# The revisions before `versions` stated them, see `core.episode.attempt_payload`.
_VERSION_DEFAULTS: Mapping[str, Any] = {"looks": "1", "engine": "1"}
# Keys that identify a part of a config -> values that older configs left out there. A part that is absent, null or
# empty means the same, so only other values are listed.
_CONFIG_DEFAULTS: tuple[tuple[frozenset[str], Mapping[str, Any]], ...] = (
    (frozenset({"rig", "task", "seed"}), {"arm": "right", "action": "drives", "look": 0}),
    (frozenset({"multisamples", "shadow_map_px"}), {"shadow_reach_m": 0.8, "smooth_shadows": False}),
    (
        frozenset({"things", "starts", "expert"}),
        {"arms": "all", "grasps": ["contact"], "held_at_the_end": False, "language_task": ""},
    ),
    (frozenset({"of", "count"}), {"named": "role"}),
    (frozenset({"collision", "inertia", "rest_height"}), {"base": "free"}),
    (frozenset({"set", "file", "origin"}), {"castshadow": True}),
    (frozenset({"friction", "condim"}), {"push_out_s": 0.02}),
    (frozenset({"force", "points"}), {"around": False, "hands": 1}),
)


def upgrade_attempt(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return a line of `attempts.jsonl` with all keys, and with full poses."""
    cast, layout = data.get("cast"), data.get("layout")
    upgraded = {"phrasing": "", **data, **_with_defaults(data, "outcome", _OUTCOME_DEFAULTS)}
    upgraded |= _with_defaults({"randomized": {}, **data}, "randomized", _RANDOMIZATION_DEFAULTS)
    upgraded["cast"] = {"sizes": {}, **cast} if isinstance(cast, Mapping) else cast
    if isinstance(layout, Mapping):
        upgraded["layout"] = {name: _full_pose(place) for name, place in layout.items()}
    return upgraded


def upgrade_episode(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of an `episode.json` with all keys, and with full poses."""
    if data.get("source") == "real":
        return {"prompt": "", "problems": [], **data}
    return {**_EPISODE_DEFAULTS, **upgrade_attempt(data), **_with_defaults(data, "versions", _VERSION_DEFAULTS)}


def upgrade_config(data: Any) -> Any:
    """Return the content of a `config.yaml`, or a part of it, with the values that older formats left out."""
    if isinstance(data, list | tuple):
        return [upgrade_config(item) for item in data]
    if not isinstance(data, Mapping):
        return data
    omitted = [values for keys, values in _CONFIG_DEFAULTS if keys <= data.keys()]
    upgraded = {name: upgrade_config(value) for name, value in data.items()}
    return {name: value for values in omitted for name, value in values.items()} | upgraded


def _with_defaults(data: Mapping[str, Any], key: str, defaults: Mapping[str, Any]) -> dict[str, Any]:
    value = data.get(key)
    if not isinstance(value, Mapping):
        return {}
    return {key: {**value, **{name: default for name, default in defaults.items() if name not in value}}}


def _full_pose(place: Any) -> Any:
    """Return `[x, y, z, yaw]` of format 1 as `[x, y, z, qw, qx, qy, qz]`, m and rad."""
    if not isinstance(place, list | tuple) or len(place) != 4 or not isinstance(place[3], int | float):
        return place
    return [*place[:3], math.cos(place[3] / 2), 0.0, 0.0, math.sin(place[3] / 2)]
