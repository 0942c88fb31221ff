"""Own sets: the files of imported things, each in a folder named by its content.

A thing's config names its set, and the name contains a hash over the files. So a dataset keeps its meshes, whatever is
imported under the same name later.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..files import sha256_bytes, sha256_file
from .store import AssetStore

ABOUT = "thing.json"  # the file beside the meshes with their hashes and origin

_NAME = re.compile(r"own-[A-Za-z][A-Za-z0-9_]*-[0-9a-f]{12}")
_FILE = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")  # one plain name


def is_own(set_name: str) -> bool:
    """Whether the name is that of an own set, which is not in the lock."""
    return _NAME.fullmatch(set_name) is not None


def _set_name(thing: str, hashes: Mapping[str, str]) -> str:
    listed = "".join(f"{name} {hashes[name]}\n" for name in sorted(hashes))
    return f"own-{thing}-{sha256_bytes(listed.encode())[:12]}"


def publish_own(store: AssetStore, thing: str, files: Mapping[str, bytes], about: Mapping[str, Any]) -> str:
    """Put a thing's files into the store in one step, and return the set's name.

    Args:
        about: the origin of the thing, for people: the source's name and hash, its unit, and how it was made.

    Raises:
        ResourceError: the store cannot be written to.
    """
    if wrong := [name for name in files if not _FILE.fullmatch(name) or name == ABOUT]:
        raise ValueError(f"no names for a set's files: {wrong}")
    hashes = {file: sha256_bytes(data) for file, data in sorted(files.items())}
    name = _set_name(thing, hashes)
    text = json.dumps({"about": about, "files": hashes}, indent=1) + "\n"
    with store.writing():
        if resolve_own(store, name) is None:
            store.put(name, {**files, ABOUT: text.encode()})
    return name


def resolve_own(store: AssetStore, set_name: str) -> Path | None:
    """The folder of an own set, every file verified by SHA-256; None if a file is missing or changed."""
    if not is_own(set_name):
        return None
    folder = store.root / set_name
    try:
        listed = json.loads((folder / ABOUT).read_bytes())["files"]
        found = {name: sha256_file(folder / name) for name in listed if _FILE.fullmatch(name)}
    except (OSError, ValueError, KeyError, TypeError):
        return None
    thing = set_name.removeprefix("own-").rpartition("-")[0]
    return folder if len(found) == len(listed) and _set_name(thing, found) == set_name else None
