"""Which meshes a composed scene shows."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PurePosixPath

import mujoco

from ..assets.reduction import REPORT
from ..files import sha256_bytes
from ..resources import Meshes
from ..shown_meshes import FULL, PRIMITIVES, REDUCED
from .blueprint import Blueprint
from .compose import mesh_sets

# Stands for the mounts that a rig has STL files of its own for.
_MOUNTS = "mounts"


def composed_meshes(spec: mujoco.MjSpec, blueprint: Blueprint, meshes: Meshes) -> dict[str, str]:
    """Asset set -> what a composed scene shows of it, see `core.shown_meshes`.

    Args:
        blueprint: what the scene was composed of.
        meshes: with which it was composed.
    """
    assets = spec.assets
    files: dict[str, dict[str, bytes]] = {}
    for mesh in spec.meshes:
        path = PurePosixPath(mesh.file)
        files.setdefault(path.parent.name, {})[path.name] = assets[mesh.file]
    found = {name: _text(meshes.get(name), files.get(name, {})) for name in mesh_sets(blueprint)}
    own = {f"{arm.mount.name}.stl" for arm in blueprint.rig.arms if arm.mount and arm.mount.stl}
    if mounts := {name: data for name, data in files.get(_MOUNTS, {}).items() if name in own}:
        found[_MOUNTS] = _text(None, mounts)
    return found


def _text(folder: Path | None, files: Mapping[str, bytes]) -> str:
    if not files:
        return PRIMITIVES
    kind = REDUCED if folder is not None and (folder / REPORT).is_file() else FULL
    listed = "".join(f"{name} {sha256_bytes(files[name])}\n" for name in sorted(files))
    return f"{kind} {sha256_bytes(listed.encode())}"
