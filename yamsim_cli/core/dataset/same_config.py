"""Whether a recording would go on as its dataset began: the same configuration, and the same meshes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import ConfigError
from ..shown_meshes import Drawn, differences, remedy, shown
from .layout import CONFIG

# What a configuration says and nobody sets: which meshes are drawn, see `core.shown_meshes`.
MESHES = "meshes"

# A message stays one line that can be read.
_SHOWN_CHANGES = 5


def require_same(dataset: Path, recorded: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    """Compare a dataset's configuration with the one that it is to go on with.

    Raises:
        ConfigError: something differs; the message names it and what to do.
    """
    changed = _changes(recorded, wanted)
    there, now = _drawn(recorded), _drawn(wanted)
    meshes = differences(there, now)
    if changed:
        changed += [f"{MESHES}.{text}" for text in meshes]
        more = f"; and {len(changed) - _SHOWN_CHANGES} more" if len(changed) > _SHOWN_CHANGES else ""
        raise ConfigError(
            f"{dataset} was recorded with another configuration: {'; '.join(changed[:_SHOWN_CHANGES])}{more}; "
            f"run with the same values (--config {dataset / CONFIG} has them), or record into another --out"
        )
    if meshes:
        raise ConfigError(
            f"{dataset} was recorded with other meshes: {'; '.join(meshes)}; {remedy(there, now)}, or record into "
            "another --out"
        )


def unsaid_meshes(dataset: Path, wanted: Mapping[str, Any]) -> str:
    """For the user: that a dataset does not say which meshes it shows, and how to find out."""
    drawn = ", ".join(f"{name}: {shown(text)}" for name, text in _drawn(wanted).items())
    return (
        f"{dataset / CONFIG} does not say which meshes the episodes show, as an earlier yamsim recorded them. New ones "
        f"show {drawn}; whether that is the same, `yamsim verify {dataset} --sample 1 --images` tells."
    )


def _drawn(config: Mapping[str, Any]) -> Drawn:
    said = config.get(MESHES)
    return {str(name): str(text) for name, text in said.items()} if isinstance(said, Mapping) else {}


def _changes(recorded: Mapping[str, Any], wanted: Mapping[str, Any]) -> list[str]:
    """`key: recorded value, wanted value` for every value that differs, meshes left out."""
    old, new = (_flatten({key: value for key, value in data.items() if key != MESHES}) for data in (recorded, wanted))
    return [
        f"{key}: {old.get(key)!r} there, {new.get(key)!r} now"
        for key in dict.fromkeys([*old, *new])
        if old.get(key) != new.get(key)
    ]


def _flatten(data: Any, prefix: str = "") -> dict[str, Any]:
    if isinstance(data, dict):
        return {
            key: value
            for name, inner in data.items()
            for key, value in _flatten(inner, f"{prefix}.{name}" if prefix else name).items()
        }
    if isinstance(data, list | tuple):
        return {key: value for k, inner in enumerate(data) for key, value in _flatten(inner, f"{prefix}[{k}]").items()}
    return {prefix: data}
