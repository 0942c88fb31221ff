"""Reads XML and JSON of OpenCV's FileStorage; `yaml_document` reads its YAML."""

from __future__ import annotations

import re
from typing import Any
from xml.parsers import expat

from ...errors import ConfigError
from ...files.documents.yaml_document import Document, KeyPath, number_or_text, parse_yaml

_ROOT_ELEMENT_NAME = "opencv_storage"

_MAX_DEPTH = 50  # levels of nested elements; a calibration has 3, and a deeper file is an attack

# FileStorage writes comments on separate lines. Its strings have no line breaks, so only comments begin with `//`.
_JSON_COMMENT = re.compile(rb"^[ \t]*//.*$", re.MULTILINE)

_XML_WORD_PATTERN = re.compile(r'"([^"]*)"|(\S+)')


def parse_json(raw: bytes, source: str) -> Document:
    """Return the content of JSON text, also with OpenCV's comments and numbers. Raises as `load_yaml`."""
    # YAML does not allow tabs. JSON has tabs only outside strings.
    return parse_yaml(_JSON_COMMENT.sub(b"", raw).replace(b"\t", b" "), source, "JSON")


class _Element:
    def __init__(self, name: str, line: int) -> None:
        self.name, self.line = name, line
        self.text = ""
        self.inside: list[_Element] = []


def parse_xml(raw: bytes, source: str) -> Document:
    """Return the content of FileStorage's XML.

    Untrusted files are safe: a document type, which entities need, is refused, and no file or URL is opened.

    Raises:
        ConfigError: the text is no XML of FileStorage, declares a document type, has a duplicate key, or is nested too
            deeply.
    """
    root = _parse_elements(raw, source)
    if root.name != _ROOT_ELEMENT_NAME:
        raise ConfigError(
            f"{source}:{root.line}: <{root.name}> is not the root of OpenCV's XML files, <{_ROOT_ELEMENT_NAME}>"
        )
    document = Document({}, source)
    try:
        data = _element_value(root, (), document)
    # Python refuses integers of thousands of digits.
    except ValueError as error:
        raise ConfigError(f"{source}: not valid: {error}") from error
    if not isinstance(data, dict):
        raise ConfigError(f"{source}: the top level must be a mapping of keys to values")
    document.data = data
    return document


def _parse_elements(raw: bytes, source: str) -> _Element:
    parser = expat.ParserCreate()
    parser.buffer_text = True
    top = _Element("", 0)
    stack = [top]

    def start(name: str, attributes: dict[str, str]) -> None:
        element = _Element(name, parser.CurrentLineNumber)
        if len(stack) > _MAX_DEPTH:
            raise ConfigError(f"{source}:{element.line}: nested more than {_MAX_DEPTH} levels deep")
        stack[-1].inside.append(element)
        stack.append(element)

    def end(name: str) -> None:
        stack.pop()

    def text(part: str) -> None:
        stack[-1].text += part

    def doctype(*_: Any) -> None:
        raise ConfigError(f"{source}:{parser.CurrentLineNumber}: no document type is allowed: remove <!DOCTYPE ...>")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = text, doctype
    try:
        parser.Parse(raw, True)
    except expat.ExpatError as error:
        raise ConfigError(f"{source}:{error.lineno}: not valid XML: {expat.ErrorString(error.code)}") from error
    # Python does not know the encoding, or expat does not support it.
    except (LookupError, ValueError) as error:
        raise ConfigError(f"{source}: not valid XML: {error}") from error
    return top.inside[0]


def _element_value(element: _Element, path: KeyPath, document: Document) -> Any:
    document.places[path] = f"{document.source}:{element.line}"
    if element.inside and all(inner.name == "_" for inner in element.inside):
        return [_element_value(inner, (*path, k), document) for k, inner in enumerate(element.inside)]
    if element.inside:
        values: dict[str, Any] = {}
        for inner in element.inside:
            if inner.name in values:
                raise ConfigError(f"{document.source}:{inner.line}: duplicate key {inner.name!r}; remove one")
            values[inner.name] = _element_value(inner, (*path, inner.name), document)
        return values
    words = [number_or_text(plain) if plain else quoted for quoted, plain in _XML_WORD_PATTERN.findall(element.text)]
    return words[0] if len(words) == 1 else words or None
