"""Sets of the user's own: the files that an imported thing is made of, in a folder named by their content.

A thing's config names its set, and the set's name holds a hash over its files. So a config, and every dataset that
holds it, says which bytes it means; another import of the same name never changes what an older one sees.
"""

from __future__ import annotations

import json
import re
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import ResourceError
from ..files import publish_directory, sha256_bytes, sha256_file
from .store import AssetStore

# Beside the files: which they are, and where they are from.
ABOUT = "thing.json"

_NAME = re.compile(r"own-[A-Za-z][A-Za-z0-9_]*-[0-9a-f]{12}")
# A part's file: one plain name.
_FILE = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")


def is_own(set_name: str) -> bool:
    """Whether a set is one of the user's own, which no lock knows."""
    return _NAME.fullmatch(set_name) is not None


def own_set_name(thing: str, files: Mapping[str, bytes]) -> str:
    """The set's name for a thing's files: file name -> content."""
    return _name(thing, {name: sha256_bytes(data) for name, data in files.items()})


def _name(thing: str, hashes: Mapping[str, str]) -> str:
    listed = "".join(f"{name} {hashes[name]}\n" for name in sorted(hashes))
    return f"own-{thing}-{sha256_bytes(listed.encode())[:12]}"


def publish_own(store: AssetStore, thing: str, files: Mapping[str, bytes], about: Mapping[str, Any]) -> str:
    """Put a thing's files into the store, all at once, and give the set's name; what is there already stays.

    Args:
        about: where the thing is from, for people: the source's name and hash, its unit, and how it was made.

    Raises:
        ResourceError: the store cannot be written to.
    """
    if wrong := [name for name in files if not _FILE.fullmatch(name) or name == ABOUT]:
        raise ValueError(f"no names for a set's files: {wrong}")
    name = own_set_name(thing, files)
    hashes = {file: sha256_bytes(data) for file, data in sorted(files.items())}
    text = json.dumps({"about": about, "files": hashes}, indent=1) + "\n"
    try:
        with store.writing() as staging:
            if resolve_own(store, name) is None:
                final = store.root / name
                if final.exists():
                    # Only reached when the folder failed verification.
                    final.rename(staging / f"damaged.{uuid.uuid4().hex}")
                publish_directory(final, {**files, ABOUT: text.encode()}, staging)
    except OSError as error:
        raise ResourceError(f"cannot write to the asset store {store.root}: {error.strerror or error}") from error
    return name


def resolve_own(store: AssetStore, set_name: str) -> Path | None:
    """The folder of one of the user's own sets, every file verified by SHA-256; None when there is none, or not so."""
    if not is_own(set_name):
        return None
    folder = store.root / set_name
    try:
        listed = json.loads((folder / ABOUT).read_bytes())["files"]
        found = {name: sha256_file(folder / name) for name in listed if _FILE.fullmatch(name)}
    except (OSError, ValueError, KeyError, TypeError):
        return None
    thing = set_name.removeprefix("own-").rpartition("-")[0]
    return folder if len(found) == len(listed) and _name(thing, found) == set_name else None


def about_own(store: AssetStore, set_name: str) -> Mapping[str, Any]:
    """What `publish_own` was told of a set; empty where it is not here."""
    try:
        about = json.loads((store.root / set_name / ABOUT).read_bytes())["about"]
    except (OSError, ValueError, KeyError, TypeError):
        return {}
    return about if isinstance(about, dict) else {}
