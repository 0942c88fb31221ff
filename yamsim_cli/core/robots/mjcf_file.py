"""Reads the MJCF file of an arm or a gripper, with what it includes from its own folder."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

from ..documents.document import read_config
from ..errors import ConfigError
from ..untrusted.includes import with_includes
from ..untrusted.jail import Folder
from ..untrusted.refusals import RefusedError

Element = ElementTree.Element

_NOT_THERE = ("outside", "missing", "not-a-file")  # codes of an include that names no file of the folder


def read_mjcf(path: Path) -> dict[str, object]:
    """The values of a `models.Mjcf`. A text without includes is the file's own, to the letter.

    Raises:
        ConfigError: the file cannot be read, is no XML, or includes what its folder does not hold.
    """
    data = read_config(path)
    try:
        text = data.decode()
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8: {error.reason}") from error
    found: dict[str, object] = {"file": str(path), "text": text}
    if "<include" not in text:
        return found
    folder = path.parent.resolve()
    try:
        root = with_includes(data, Folder(folder), folder, root_of)
    except RefusedError as error:
        mend = f"; an <include> names an MJCF below {path.parent}" if error.code in _NOT_THERE else ""
        raise ConfigError(f"{path}: {error}{mend}") from error
    return found | {"text": ElementTree.tostring(root, encoding="unicode"), "includes": True}


def root_of(data: str | bytes) -> Element:
    """The root element of an XML text.

    Raises:
        RefusedError: it is none, or declares entities.
    """
    text = data if isinstance(data, str) else data.decode(errors="replace")
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise RefusedError("xml-entities", "declares a document type, which no MJCF needs; remove it")
    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise RefusedError("damaged", f"not valid XML: {error}") from error
