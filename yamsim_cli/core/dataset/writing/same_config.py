"""Checks that a dataset is continued with the configuration and the meshes that it was begun with."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...documents.document import load_yaml
from ...errors import ConfigError
from ...shown_meshes import ShownMeshes, differences, remedy, shown
from ..layout import CONFIG

# What a configuration says and nobody sets: which meshes are shown, see `core.shown_meshes`.
MESHES = "meshes"

# How many changes a message names, so that its line stays readable.
_SHOWN_CHANGES = 5


def require_same(dataset: Path, recorded: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    """Compare a dataset's configuration with the one that it is to be continued with.

    Raises:
        ConfigError: they differ; the message names the keys, and what to do.
    """
    changed = _changes(recorded, wanted)
    there, now = _said(recorded), _said(wanted)
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
    """A notice that a dataset does not say which meshes it shows, and how to find out."""
    texts = ", ".join(f"{name}: {shown(text)}" for name, text in _said(wanted).items())
    return (
        f"{dataset / CONFIG} does not say which meshes the episodes show, as an earlier yamsim recorded them. New ones "
        f"show {texts}; whether that is the same, `yamsim verify {dataset} --sample 1 --images` tells."
    )


def shown_in(dataset: Path) -> ShownMeshes:
    """Return what a dataset says of its meshes: nothing where it has no config that can be read."""
    try:
        return _said(load_yaml(dataset / CONFIG).data)
    except ConfigError:
        return {}


def _said(config: Mapping[str, Any]) -> ShownMeshes:
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
