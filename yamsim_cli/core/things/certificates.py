"""Certificates on the disk: what was found of a thing, under a hash of all that it was found from."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from ..assets import AssetLock
from ..config.things.made import MADE, made_files
from ..config.things.thing import ObjectConfig
from ..errors import ResourceError
from ..files import sha256_bytes, write_file

#: Grows whenever a check decides otherwise: older certificates are stale then.
CHECKS_VERSION = 1

_FOLDER = "certificates"
# Of one of the user's own sets: another import of the same thing has another.
_CONTENT = re.compile(r"-[0-9a-f]{12}$")


class Standing(StrEnum):
    """How a thing stands with its certificate."""

    NONE = "not certified"
    GOOD = "certified"
    FAILED = "failed"
    STALE = "stale"


@dataclass(frozen=True)
class Certificate:
    """A stored result: how it stands now, which checks failed, and its file; None where there is none."""

    standing: Standing
    failed: tuple[str, ...] = ()
    path: Path | None = None


def inputs_hash(item: ObjectConfig, lock: AssetLock) -> str:
    """SHA-256 over everything that a certificate is made from: config, meshes, and the checks themselves."""
    files = {}
    for mesh in item.all_meshes:
        # The set of the user's own names its content, and a folder of theirs is not ours to vouch for.
        locked = lock.sets.get(mesh.set)
        files[f"{mesh.set}/{mesh.file}"] = (
            locked.files[mesh.file].sha256 if locked and mesh.file in locked.files else ""
        )
    if item.shape is not None:
        made = made_files(item.name, item.shape)
        files |= {f"{MADE}/{name}": sha256_bytes(data) for name, data in made.items()}
    told = {"checks": CHECKS_VERSION, "config": item.model_dump(mode="json"), "files": files}
    return sha256_bytes(json.dumps(told, sort_keys=True).encode())


def store_certificate(
    assets: Path, item: ObjectConfig, lock: AssetLock, found: Mapping[str, Any], made_with: Mapping[str, str]
) -> Path:
    """Keep what was found of a thing, in place of an older certificate, and give its file.

    Args:
        assets: the cache of meshes.
        made_with: names and versions of what found it.

    Raises:
        ResourceError: it cannot be written.
    """
    path = _path(assets, item)
    text = json.dumps({"inputs": inputs_hash(item, lock), "made_with": dict(made_with), **found}, indent=1) + "\n"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, text.encode())
    except OSError as error:
        raise ResourceError(f"the certificate {path} cannot be written: {error.strerror}") from error
    return path


def find_certificate(assets: Path, item: ObjectConfig, lock: AssetLock) -> Certificate:
    """How a thing stands; what cannot be read counts as no certificate."""
    path = _path(assets, item)
    try:
        stored = json.loads(path.read_bytes())
        inputs, checks = stored["inputs"], stored["checks"]
        failed = tuple(str(check["code"]) for check in checks if check["ok"] is False)
    except (OSError, ValueError, KeyError, TypeError):
        return Certificate(Standing.NONE)
    if inputs != inputs_hash(item, lock):
        return Certificate(Standing.STALE, failed, path)
    return Certificate(Standing.FAILED if failed else Standing.GOOD, failed, path)


def _path(assets: Path, item: ObjectConfig) -> Path:
    """One file for each thing: two of one name differ in what is seen of them."""
    which = f"{item.name} {_CONTENT.sub('', item.mesh.set)} {item.mesh.file}"
    return assets / _FOLDER / f"{item.name}-{sha256_bytes(which.encode())[:8]}.json"
