from __future__ import annotations

import contextlib
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path

from .confined_folder import ConfinedFolder
from .refusals import RefusedError

Element = ElementTree.Element

_MAX_DEPTH = 8  # levels of includes; more are a mistake or an attack


def expand_includes(data: bytes, folder: ConfinedFolder, base: Path, parse: Callable[[bytes], Element]) -> Element:
    """Return the root of an untrusted MJCF document with each `<include>` replaced as in MuJoCo.

    Args:
        base: folder of the main file. Names are relative to `base`, or else to the folder of the including file.
        parse: returns the root of a document, or raises `RefusedError`.
    """
    return _expand_document(data, folder, (base,), (), parse)


def _expand_document(
    data: bytes,
    folder: ConfinedFolder,
    bases: tuple[Path, ...],
    ancestors: tuple[Path, ...],
    parse: Callable[[bytes], Element],
) -> Element:
    try:
        root = parse(data)
    except RefusedError as error:
        raise RefusedError(error.code, f"{ancestors[-1].name}: {error}" if ancestors else str(error)) from error
    for parent in list(root.iter()):
        for place, child in reversed(list(enumerate(parent))):
            if child.tag != "include":
                continue
            path = _find_included_file(child.get("file", ""), folder, bases)
            if path in ancestors or len(ancestors) >= _MAX_DEPTH:
                raise RefusedError("cycle", f"{path.name} includes itself, or more than {_MAX_DEPTH} levels deep")
            included = folder.read(path.name, path.parent)
            inner = _expand_document(included, folder, (bases[0], path.parent), (*ancestors, path), parse)
            parent[place : place + 1] = list(inner)
    return root


def _find_included_file(name: str, folder: ConfinedFolder, bases: tuple[Path, ...]) -> Path:
    for base in bases[:-1]:
        with contextlib.suppress(RefusedError):
            return folder.find(name, base)
    return folder.find(name, bases[-1])
