"""From a config's name or file to a checked model, with errors that name file, key, value and what would be valid."""

from __future__ import annotations

import types
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from ..errors import ConfigError, UsageError, suggest
from ..resources import Locations
from .base import Config, Reference
from .camera import CameraConfig
from .document import Document, KeyPath, parse_yaml
from .objects import ObjectConfig
from .randomization import RandomizationConfig
from .record import RecordConfig, RenderConfig
from .rig import RigConfig
from .scene import SceneConfig
from .task import TaskConfig

KINDS: Mapping[str, type[Config]] = {
    "rigs": RigConfig,
    "scenes": SceneConfig,
    "tasks": TaskConfig,
    "objects": ObjectConfig,
    "cameras": CameraConfig,
    "quality": RenderConfig,
    "randomization": RandomizationConfig,
    "record": RecordConfig,
}

C = TypeVar("C", bound=Config)


def model_of(kind: str) -> type[Config]:
    """The model of a kind of config.

    Raises:
        ConfigError: there is no such kind.
    """
    if kind not in KINDS:
        raise ConfigError(f"unknown kind of config {kind!r}; {suggest(kind, KINDS)}")
    return KINDS[kind]


def load_config(
    model: type[C],
    kind: str,
    name: str,
    locations: Locations,
    overrides: Mapping[KeyPath, tuple[str, Any]] | None = None,
) -> C:
    """Load, complete and check one config.

    Args:
        model: what it must be.
        kind: folder under `configs/`.
        name: a config's name, or the path of a file, see `Locations.config_file`.
        overrides: key path -> (what set it, value), such as `("image", "jpeg_quality"): ("--jpeg-quality", 90)`.

    Raises:
        ConfigError: with file, line, key path, value and what would be valid.
        UsageError: the value at fault came by an override whose place begins with `--`.
    """
    document = _read(model, locations.config_file(kind, name))
    # References are resolved between the two passes, so that a flag may reach inside a config named by another flag.
    changes = overrides or {}
    for path, (place, value) in changes.items():
        if len(path) == 1:
            document.set(path, value, place)
    _resolve_references(model, document, (), locations)
    for path, (place, value) in changes.items():
        if len(path) > 1:
            document.set(path, value, place)
    return _check(model, document, locations)


def validate_file(model: type[C], path: Path, locations: Locations) -> C:
    """Check a file against a model. Raises as `load_config`."""
    return _check(model, _read(model, path), locations)


def parse_config(model: type[C], text: str, source: str, locations: Locations) -> C:
    """Check YAML text, such as a dataset's own `config.yaml`, against a model. Raises as `load_config`."""
    return _check(model, parse_yaml(text, source), locations)


def _read(model: type[Config], path: Path) -> Document:
    document = model.read(path)
    if "name" in model.model_fields:
        document.data.setdefault("name", path.stem)
    return document


def _check(model: type[C], document: Document, locations: Locations) -> C:
    _resolve_references(model, document, (), locations)
    try:
        return model.model_validate(document.data)
    except ValidationError as error:
        place, message = _explain(model, document, error)
        # A bad value that came by a flag is a fault of the command line, not of any config.
        kind = UsageError if place.startswith("--") else ConfigError
        raise kind(f"{place}: {message}") from error


def _references(model: type[Config]) -> Iterator[tuple[str, str, type[Config]]]:
    for name, info in model.model_fields.items():
        for mark in info.metadata:
            if isinstance(mark, Reference):
                yield name, mark.kind, KINDS[mark.kind]


def _resolve_references(model: type[Config], document: Document, path: KeyPath, locations: Locations) -> None:
    """Replace the names of other configs by their content, in place."""
    here: Any = document.data
    for key in path:
        here = here[key]
    for name, kind, target in _references(model):
        items = list(here[name]) if isinstance(here.get(name), list) else None
        named = {(*path, name): here.get(name)} if items is None else {(*path, name, k): v for k, v in enumerate(items)}
        for inner, value in named.items():
            if isinstance(value, str):
                _put_in(document, inner, kind, target, value, locations)
            if isinstance(value, str | dict):
                _resolve_references(target, document, inner, locations)
    for name, info in model.model_fields.items():
        if not any(isinstance(mark, Reference) for mark in info.metadata) and isinstance(here.get(name), dict):
            for part in _models_in(info.annotation):
                if issubclass(part, Config):
                    _resolve_references(part, document, (*path, name), locations)


def _put_in(
    document: Document, path: KeyPath, kind: str, target: type[Config], name: str, locations: Locations
) -> None:
    """Replace the name of a config at `path` by its content."""
    try:
        file = locations.config_file(kind, name)
    except ConfigError as error:
        raise ConfigError(f"{document.place(path)}: {_dotted(path)}: {error}") from error
    document.graft(path, _read(target, file))


def _explain(model: type[Config], document: Document, error: ValidationError) -> tuple[str, str]:
    """Where the first fault stands; and one line on it, and on how many more there are."""
    found = error.errors(include_url=False)
    # A list with a faulty item is reported as too short as well: only what is inside says what to mend.
    inside = {detail["loc"][:depth] for detail in found for depth in range(len(detail["loc"]))}
    # A mistyped key shows up twice, as unknown and as missing; the place where it stands comes first.
    details = sorted(
        (detail for detail in found if detail["loc"] not in inside), key=lambda detail: detail["type"] == "missing"
    )
    first = details[0]
    path: KeyPath = tuple(key for key in first["loc"] if not _is_tag(document.data, first["loc"], key))
    more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
    place = document.place(path)
    key = "" if place.startswith("--") else f"{_dotted(path) or 'config'}: "
    return place, f"{key}{_reason(model, path, first)}{more}"


def _reason(model: type[Config], path: KeyPath, detail: ErrorDetails) -> str:
    if detail["type"] == "extra_forbidden":
        return f"unknown key; {suggest(str(path[-1]), _keys_at(model, path[:-1]))}"
    if detail["type"] == "missing":
        return "missing; add it"
    message = detail["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
    value = detail["input"]
    return message if isinstance(value, dict) else f"{value!r} is not valid: {message}"


def _is_tag(data: Any, loc: tuple[int | str, ...], key: int | str) -> bool:
    """Whether a part of pydantic's location names a union's branch rather than a key of the document."""
    here = data
    for part in loc:
        if isinstance(here, dict) and part not in here and part == here.get("type"):
            if part == key:
                return True
            continue
        try:
            here = here[part]
        except (KeyError, IndexError, TypeError):
            return False
    return False


def _keys_at(model: type[BaseModel], path: KeyPath) -> list[str]:
    """The keys valid at a path, through nested models, tuples and unions."""
    models = [model]
    for key in path:
        found: list[type[BaseModel]] = []
        for candidate in models:
            if isinstance(key, int):
                found.append(candidate)
            elif key in candidate.model_fields:
                found.extend(_models_in(candidate.model_fields[key].annotation))
        models = found
    return sorted({name for candidate in models for name in candidate.model_fields})


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) in (Annotated, Union, types.UnionType, tuple, list):
        return [model for part in get_args(annotation) for model in _models_in(part)]
    return []


def _dotted(path: KeyPath) -> str:
    text = ""
    for key in path:
        text += f"[{key}]" if isinstance(key, int) else f".{key}" if text else str(key)
    return text
