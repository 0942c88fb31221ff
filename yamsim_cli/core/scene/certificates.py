"""Certificates: files with the results of an object's checks, named by a hash of the object's config and meshes."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from ..config.objects.generated import GENERATED_SET, generated_mesh_files
from ..config.objects.object_config import ObjectConfig
from ..errors import ResourceError
from ..files.writing import sha256_bytes, write_file
from .assets import AssetLock

_CHECKS_VERSION = 3  # increases with each change of the checks' decisions, which makes older certificates stale
_FOLDER = "certificates"
_CONTENT_HASH_PATTERN = re.compile(r"-[0-9a-f]{12}$")  # content hash at the end of an imported set's name


class CertificateStatus(StrEnum):
    """State of a certificate; `STALE` if it was made for another config, other meshes or other checks."""

    NONE = "not certified"
    GOOD = "certified"
    FAILED = "failed"
    STALE = "stale"


@dataclass(frozen=True)
class Certificate:
    """State, codes of the failed checks, and file of an object's certificate."""

    status: CertificateStatus
    failed: tuple[str, ...] = ()
    path: Path | None = None


def inputs_hash(item: ObjectConfig, lock: AssetLock) -> str:
    """Return the SHA-256 of all inputs of a certificate: config, meshes, and version of the checks."""
    files = {}
    for mesh in item.all_meshes:
        # The name of an imported set contains a hash of its content. The hash of other sets is unknown.
        locked = lock.sets.get(mesh.set)
        files[f"{mesh.set}/{mesh.file}"] = (
            locked.files[mesh.file].sha256 if locked and mesh.file in locked.files else ""
        )
    if item.shape is not None:
        made = generated_mesh_files(item.name, item.shape)
        files |= {f"{GENERATED_SET}/{name}": sha256_bytes(data) for name, data in made.items()}
    # Defaults are left out, so that a new key of objects makes no certificate stale.
    config = item.model_dump(mode="json", exclude_defaults=True)
    inputs = {"checks": _CHECKS_VERSION, "config": config, "files": files}
    return sha256_bytes(json.dumps(inputs, sort_keys=True).encode())


def store_certificate(
    assets: Path, item: ObjectConfig, lock: AssetLock, found: Mapping[str, Any], made_with: Mapping[str, str]
) -> Path:
    """Write the certificate of an object's present config and meshes, and return its file. Older ones are kept.

    `assets` is the folder of the asset store, `found` the results as JSON values, and `made_with` program -> version.
    """
    inputs = inputs_hash(item, lock)
    path = _certificate_path(assets, item, inputs)
    text = json.dumps({"inputs": inputs, "made_with": dict(made_with), **found}, indent=1) + "\n"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, text.encode())
    except OSError as error:
        raise ResourceError(f"the certificate {path} cannot be written: {error.strerror}") from error
    return path


def find_certificate(assets: Path, item: ObjectConfig, lock: AssetLock) -> Certificate:
    """Return the certificate of an object's present config and meshes, else its newest older one, as `STALE`.

    Unreadable certificates are ignored.
    """
    inputs = inputs_hash(item, lock)
    path = _certificate_path(assets, item, inputs)
    if (failed := _failed_checks(path, inputs)) is not None:
        return Certificate(CertificateStatus.FAILED if failed else CertificateStatus.GOOD, failed, path)
    for older in _older_certificates(path, item):
        if (failed := _failed_checks(older)) is not None:
            return Certificate(CertificateStatus.STALE, failed, older)
    return Certificate(CertificateStatus.NONE)


def _failed_checks(path: Path, inputs: str | None = None) -> tuple[str, ...] | None:
    try:
        stored = json.loads(path.read_bytes())
        if inputs not in (None, stored["inputs"]):
            return None
        return tuple(str(check["code"]) for check in stored["checks"] if check["ok"] is False)
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _certificate_path(assets: Path, item: ObjectConfig, inputs: str) -> Path:
    return assets / _FOLDER / f"{item.name}-{_mesh_name_hash(item, item.mesh.set)}-{inputs[:12]}.json"


def _older_certificates(path: Path, item: ObjectConfig) -> list[Path]:
    """Return an object's certificate files for any config and meshes, the newest first and the one of 0.2.0 last.

    Up to version 0.2.0, file names had no content hash, and imports of different files under one name shared a file.
    """
    shared = f"{item.name}-{_mesh_name_hash(item, _CONTENT_HASH_PATTERN.sub('', item.mesh.set))}.json"
    found = path.parent.glob(f"{item.name}-{_mesh_name_hash(item, item.mesh.set)}-*.json")
    return [*sorted(found, key=lambda file: file.stat().st_mtime_ns, reverse=True), path.with_name(shared)]


def _mesh_name_hash(item: ObjectConfig, mesh_set: str) -> str:
    """Return 8 hex digits of a hash of the mesh's name, which distinguish objects of the same name."""
    return sha256_bytes(f"{item.name} {mesh_set} {item.mesh.file}".encode())[:8]
