"""Strict YAML 1.2 with the line of each value.

PyYAML's own loader keeps the last of two equal keys, reads `1e-3` as text, and reads `on` and `yes` as true.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from ...errors import ConfigError

KeyPath = tuple[str | int, ...]

_MAX_BYTES = 1_000_000  # bytes; a larger config is a mistake or an attack

_INTEGER_PATTERN = re.compile(r"^[-+]?[0-9]+$")
_FLOAT_PATTERN = re.compile(
    r"^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|Nan|NaN|NAN))$"
)


def is_setting(place: str) -> bool:
    """Return whether a value has the place of a flag (`--arm`), argument (`NAME`) or keyword (`arm=`), not a file."""
    return place.startswith("--") or place.endswith("=") or (place.isidentifier() and place.isupper())


class _AliasRefusal(yaml.composer.Composer):
    """Composes nodes from the parser's events. It stands before libyaml's own composer, which cannot refuse aliases."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        events: Any = self
        if events.check_event(yaml.AliasEvent):
            event = events.peek_event()
            problem = (
                f"alias *{event.anchor} is not supported: an error message could not name the line of its value, and "
                f"nested aliases can make a small file huge; repeat the value, and remove &{event.anchor}"
            )
            raise yaml.composer.ComposerError(None, None, problem, event.start_mark)
        node: yaml.Node | None = super().compose_node(parent, index)
        return node


class _Loader(_AliasRefusal, yaml.SafeLoader):
    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012  (PyYAML's own name)

    def __init__(self, stream: str | bytes) -> None:
        # The composer, which comes first, takes no stream.
        yaml.SafeLoader.__init__(self, stream)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:bool", re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"), list("tTfF")
)
_Loader.add_implicit_resolver("tag:yaml.org,2002:null", re.compile(r"^(?:~|null|Null|NULL|)$"), ["~", "n", "N", ""])
_Loader.add_implicit_resolver("tag:yaml.org,2002:int", _INTEGER_PATTERN, list("-+0123456789"))
_Loader.add_implicit_resolver("tag:yaml.org,2002:float", _FLOAT_PATTERN, list("-+0123456789."))


def _construct_int(loader: _Loader, node: yaml.ScalarNode) -> int:
    # PyYAML's own constructor reads 010 as an octal number.
    return int(node.value)


def _construct_float(loader: _Loader, node: yaml.ScalarNode) -> float:
    return _parse_float(node.value)


def _parse_float(text: str) -> float:
    return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))


def number_or_text(text: str) -> int | float | str:
    """Return an unquoted word of YAML as a number if possible."""
    if _INTEGER_PATTERN.fullmatch(text):
        return int(text)
    return _parse_float(text) if _FLOAT_PATTERN.fullmatch(text) else text


def _construct_opencv_matrix(loader: _Loader, node: yaml.MappingNode) -> dict[Any, Any]:
    # OpenCV's FileStorage tags its matrices: mappings of rows, cols, dt and data, or of sizes, dt and data.
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _construct_opencv_matrix)
_Loader.add_constructor("tag:yaml.org,2002:opencv-nd-matrix", _construct_opencv_matrix)
_Loader.add_constructor("tag:yaml.org,2002:int", _construct_int)
_Loader.add_constructor("tag:yaml.org,2002:float", _construct_float)


# A PyYAML that was built without libyaml lacks `CSafeLoader`.
_ParserBase: type[yaml.SafeLoader] = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _FastLoader(_AliasRefusal, _ParserBase):  # type: ignore[misc, valid-type]
    """Reads by libyaml's parser, in a fifth of the time. Its error messages have less detail."""

    yaml_implicit_resolvers = _Loader.yaml_implicit_resolvers
    yaml_constructors = _Loader.yaml_constructors

    def __init__(self, stream: str | bytes) -> None:
        _ParserBase.__init__(self, stream)
        _AliasRefusal.__init__(self)


class _Dumper(yaml.SafeDumper):
    """Quotes text which YAML 1.1 or 1.2 would read as another type."""

    yaml_implicit_resolvers = {  # noqa: RUF012  (PyYAML's own name)
        first: [*theirs, *_Loader.yaml_implicit_resolvers.get(first, [])]
        for first, theirs in yaml.SafeDumper.yaml_implicit_resolvers.items()
    }


def _represent_text(dumper: _Dumper, text: str) -> yaml.ScalarNode:
    # Outside double quotes, NEL (U+0085) is a line break.
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style='"' if "\x85" in text else None)


_Dumper.add_representer(str, _represent_text)


@dataclass
class Document:
    """The content of a config file, and the place ("file:line" or "--flag") of each value."""

    data: dict[str, Any]
    source: str
    places: dict[KeyPath, str] = field(default_factory=dict)

    def place_of(self, path: KeyPath) -> str:
        """Return the place of the value at `path`, or of the nearest mapping or list around it."""
        while path and path not in self.places:
            path = path[:-1]
        return self.places.get(path, self.source)

    def override_value(self, path: KeyPath, value: Any, place: str) -> None:
        """Override one value, and create missing mappings above it."""
        target: Any = self.data
        try:
            for key in path[:-1]:
                target = target.setdefault(key, {}) if isinstance(target, dict) else target[key]
            target[path[-1]] = value
        except TypeError:
            return  # a mapping is missing; validation reports this
        self.places = {known: where for known, where in self.places.items() if known[: len(path)] != path}
        self.places[path] = place

    def insert_document(self, path: KeyPath, other: Document) -> None:
        """Insert another document with the places of its values."""
        self.override_value(path, other.data, other.source)
        self.places.update({path + inner: where for inner, where in other.places.items()})


def load_yaml(path: Path) -> Document:
    """Return the content of a YAML file, with a mapping at the top level, or raise ConfigError.

    Files over 1 MB, duplicate keys and several documents are errors.
    """
    return parse_yaml(read_config_bytes(path), str(path))


def read_config_bytes(path: Path) -> bytes:
    """Return a config file's bytes. Raises ConfigError if it is unreadable, or larger than 1 MB."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    if len(raw) > _MAX_BYTES:
        raise ConfigError(f"{path}: {len(raw)} bytes is too large for a config; at most {_MAX_BYTES}")
    return raw


def parse_yaml(text: str | bytes, source: str, language: str = "YAML") -> Document:
    """Return the content of YAML or JSON text; `source` and `language` name it in messages. Raises as `load_yaml`."""
    text = _without_opencv_header(text)
    try:
        try:
            return _parse(_FastLoader(text), source, language)
        except yaml.YAMLError:
            return _parse(_Loader(text), source, language)
    except yaml.MarkedYAMLError as error:
        line = f":{error.problem_mark.line + 1}" if error.problem_mark else ""
        raise ConfigError(f"{source}{line}: not valid {language}: {error.problem}") from error
    # Explicit tags on unsuitable values, and integers of thousands of digits, raise the last three.
    except (yaml.YAMLError, RecursionError, ValueError, KeyError, AttributeError) as error:
        raise ConfigError(f"{source}: not valid {language}: {' '.join(str(error).split())}") from error


def _parse(loader: _Loader | _FastLoader, source: str, language: str) -> Document:
    document = Document({}, source)
    try:
        root = loader.get_node() if loader.check_node() else None
        if not isinstance(root, yaml.MappingNode) or root.tag != "tag:yaml.org,2002:map":
            raise ConfigError(f"{source}: the top level must be a mapping of keys to values")
        _refuse_further_documents(loader, source, language)
        _record_places(root, (), document)
        document.data = loader.construct_document(root)
    finally:
        loader.dispose()
    return document


def _refuse_further_documents(loader: _Loader | _FastLoader, source: str, language: str) -> None:
    """A final line `---`, as from `ros2 topic echo`, does not begin a second document."""
    while loader.check_node():
        node = loader.get_node()
        if node is not None and not (isinstance(node, yaml.ScalarNode) and node.value == ""):
            line = node.start_mark.line + 1
            raise ConfigError(f"{source}:{line}: not valid {language}: a second document begins here; keep one")


def _without_opencv_header(text: str | bytes) -> str | bytes:
    """OpenCV's first line `%YAML:1.0` is no valid YAML: make it a comment."""
    if isinstance(text, bytes):
        return b"#" + text if text.startswith(b"%YAML:") else text
    return "#" + text if text.startswith("%YAML:") else text


def _record_places(node: yaml.Node, path: KeyPath, document: Document) -> None:
    document.places[path] = f"{document.source}:{node.start_mark.line + 1}"
    if isinstance(node, yaml.MappingNode):
        seen: dict[str, int] = {}
        for key, value in node.value:
            line = key.start_mark.line + 1
            if not isinstance(key, yaml.ScalarNode) or key.tag != "tag:yaml.org,2002:str":
                raise ConfigError(f"{document.source}:{line}: a key must be plain text")
            if key.value in seen:
                first = seen[key.value]
                raise ConfigError(
                    f"{document.source}:{line}: duplicate key {key.value!r}, first at line {first}; remove one"
                )
            seen[key.value] = line
            _record_places(value, (*path, key.value), document)
    elif isinstance(node, yaml.SequenceNode):
        for position, item in enumerate(node.value):
            _record_places(item, (*path, position), document)


def dump_yaml(data: Mapping[str, Any]) -> str:
    """Return YAML text with keys in their order; `parse_yaml` restores the data."""
    text: str = yaml.dump(
        _tuples_to_lists(data), Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=120, default_flow_style=None
    )
    return text


def _tuples_to_lists(value: Any) -> Any:
    """YAML's safe dumper refuses tuples: make them lists."""
    if isinstance(value, Mapping):
        return {key: _tuples_to_lists(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_tuples_to_lists(item) for item in value]
    return value
