"""What an MJCF file includes, put into its place."""

from __future__ import annotations

import contextlib
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path

from .jail import Folder
from .refusals import RefusedError

Element = ElementTree.Element

_DEEPEST = 8  # files that include each other in turn; more is a mistake or an attack


def with_includes(data: bytes, folder: Folder, base: Path, parse: Callable[[bytes], Element]) -> Element:
    """The root of an MJCF document, each `<include>` replaced by what the named file holds, as MuJoCo does it.

    Args:
        data: the main file's content.
        folder: reads the included files.
        base: the main file's folder. Names are relative to it, or else to the folder of the file that has the include.
        parse: returns the root of a document, or raises `RefusedError`.

    Raises:
        RefusedError: an included file cannot be read or parsed, or includes itself.
    """
    return _whole(data, folder, (base,), (), parse)


def _whole(
    data: bytes,
    folder: Folder,
    bases: tuple[Path, ...],
    on_way: tuple[Path, ...],
    parse: Callable[[bytes], Element],
) -> Element:
    try:
        root = parse(data)
    except RefusedError as error:
        raise RefusedError(error.code, f"{on_way[-1].name}: {error}" if on_way else str(error)) from error
    for parent in list(root.iter()):
        for place, child in reversed(list(enumerate(parent))):
            if child.tag != "include":
                continue
            path = _included(child.get("file", ""), folder, bases)
            if path in on_way or len(on_way) >= _DEEPEST:
                raise RefusedError("cycle", f"{path.name} includes itself, or more than {_DEEPEST} levels deep")
            included = folder.read(path.name, path.parent)
            inner = _whole(included, folder, (bases[0], path.parent), (*on_way, path), parse)
            parent[place : place + 1] = list(inner)
    return root


def _included(name: str, folder: Folder, bases: tuple[Path, ...]) -> Path:
    """The file that an include names, in the first folder that has it."""
    for base in bases[:-1]:
        with contextlib.suppress(RefusedError):
            return folder.find(name, base)
    return folder.find(name, bases[-1])
