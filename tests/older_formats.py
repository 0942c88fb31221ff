"""Datasets of today, written again as older versions of yamsim wrote them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from yamsim_cli.core.dataset.dataset_paths import (
    CONFIG_FILE,
    EPISODE_FILE,
    LEDGER_FILE,
    MANIFEST_FILE,
    episode_directories,
)
from yamsim_cli.core.files.documents.yaml_document import dump_yaml, load_yaml
from yamsim_cli.core.files.writing import sha256_bytes
from yamsim_cli.core.geometry.se3 import pose_from_quat, yaw

# What older versions did not write, if it had these values.
_RECORDS: dict[str, Any] = {
    "arms": 1,
    "drives": 7,
    "joint_actions": False,
    "cast": None,
    "phrasing": "",
    "joints": {},
    "cloths": {},
    "meshes": None,
    "measures": [],
    "recoveries": [],
    "sizes": {},
    "arm_dynamics": [],
}
_CONFIGS: dict[str, Any] = {
    "arm": "right",
    "action": "drives",
    "shadow_reach_m": 0.8,
    "smooth_shadows": False,
    "arms": "all",
    "grasps": ["contact"],
    "held_at_the_end": False,
    "language_task": "",
    "named": "role",
    "base": "free",
    "castshadow": True,
    "push_out_s": 0.02,
    "around": False,
    "hands": 1,
    "sizes": [],
    "arrangements": [],
    "links": [],
    "handles": [],
    "modes": [],
    **dict.fromkeys(
        (
            "shape",
            "cloth",
            "support",
            "rests",
            "tilt_deg",
            "texture",
            "from_arm",
            "crumpled",
            "dynamics",
            "name",
            "side",
        )
    ),
}


def write_as_format(dataset: Path, version: int) -> Path:
    """Write a simulated dataset's JSON and YAML as format version 1 or 2 had them; other files stay."""
    config = _without(load_yaml(dataset / CONFIG_FILE).data, _CONFIGS | {"cameras": None, "meshes": None})
    (dataset / CONFIG_FILE).write_text(dump_yaml({key: value for key, value in config.items() if value != []}))
    lines = [_older(json.loads(line), version) for line in (dataset / LEDGER_FILE).read_text().splitlines()]
    (dataset / LEDGER_FILE).write_text("".join(json.dumps(line) + "\n" for line in lines))
    manifest = json.loads((dataset / MANIFEST_FILE).read_text()) | {"format_version": 1}
    for entry, (_, directory) in zip(manifest["episodes"], episode_directories(dataset), strict=True):
        record = _older(json.loads((directory / EPISODE_FILE).read_text()), version) | {"format_version": version}
        if version == 1:
            record["versions"] = _without(record["versions"], {"looks": record["versions"]["looks"], "engine": "3"})
        before, text = (directory / EPISODE_FILE).stat().st_size, (json.dumps(record) + "\n").encode()
        (directory / EPISODE_FILE).write_bytes(text)
        entry |= {"sha256": sha256_bytes(text), "bytes": entry["bytes"] + len(text) - before}
    manifest["bytes"] = sum(entry["bytes"] for entry in manifest["episodes"])
    (dataset / MANIFEST_FILE).write_text(json.dumps(manifest, indent=1) + "\n")
    return dataset


def _without(data: Any, left_out: dict[str, Any]) -> Any:
    if isinstance(data, list):
        return [_without(item, left_out) for item in data]
    if not isinstance(data, dict):
        return data
    always = {"castshadow"} if "set" not in data else set()  # lights always state it, meshes of objects do not
    kept = {k: value for k, value in data.items() if k in always or k not in left_out or value != left_out[k]}
    return {key: _without(value, left_out) for key, value in kept.items()}


def _older(record: dict[str, Any], version: int) -> dict[str, Any]:
    if not any(record["randomized"].values()):
        del record["randomized"]
    if version == 1:
        record |= {"cast": None, "phrasing": "", "outcome": record["outcome"] | {"measures": [], "recoveries": []}}
        for thing, place in record["layout"].items():
            record["layout"][thing] = [*place[:3], yaw(pose_from_quat(place[:3], place[3:]))]
    return dict(_without(record, _RECORDS))
