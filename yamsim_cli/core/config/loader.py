"""From a config's name or file to a checked model, with errors that name file, key, value and what would be valid."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from ..errors import ConfigError, UsageError, suggest
from ..resources import Locations
from .base import Config, Reference
from .camera import CameraConfig
from .document import Document, KeyPath, is_setting, parse_yaml
from .explain import dotted, explain, kind_instead, models_in
from .randomization import RandomizationConfig
from .recording import RecordConfig, RenderConfig
from .rig import RigConfig
from .scene import SceneConfig
from .task import TaskConfig
from .things import ObjectConfig
from .units import AS_RECORDED

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
    if instead := _other_kind(model, document):
        raise ConfigError(instead)
    # References are resolved between the two passes, so that a flag may reach inside a config named by another flag.
    changes = overrides or {}
    for path, (place, value) in changes.items():
        if len(path) == 1:
            document.set(path, value, place)
    _resolve_references(model, document, (), locations)
    for path, (place, value) in changes.items():
        if len(path) > 1:
            document.set(path, value, place)
    flags = {path: place for path, (place, _) in changes.items() if is_setting(place)}
    return _check(model, document, locations, flags)


def validate_file(model: type[C], path: Path, locations: Locations, *, as_recorded: bool = False) -> C:
    """Check a file against a model; for `as_recorded` see `parse_config`. Raises as `load_config`."""
    return _check(model, _read(model, path), locations, as_recorded=as_recorded)


def parse_config(model: type[C], text: str, source: str, locations: Locations, *, as_recorded: bool = False) -> C:
    """Check YAML text against a model. Raises as `load_config`.

    Args:
        as_recorded: it is a dataset's own, whose values may be implausible: it was recorded with them.
    """
    return _check(model, parse_yaml(text, source), locations, as_recorded=as_recorded)


def _read(model: type[Config], path: Path) -> Document:
    document = model.read(path)
    if "name" in model.model_fields:
        document.data.setdefault("name", path.stem)
    return document


def _other_kind(model: type[Config], document: Document) -> str | None:
    """What to tell of a file that is of another kind of config, going by its keys; None if it is none."""
    kind = next((kind for kind, known in KINDS.items() if known is model), None)
    if kind is None or (instead := kind_instead(KINDS, kind, document.data)) is None:
        return None
    keys = ", ".join(sorted(set(document.data) - {"name"})[:3])
    return f"{document.source}: is of the kind {instead!r}, to judge by its keys {keys}; give one of {kind!r}"


def _check(
    model: type[C],
    document: Document,
    locations: Locations,
    flags: Mapping[KeyPath, str] | None = None,
    *,
    as_recorded: bool = False,
) -> C:
    if instead := _other_kind(model, document):
        raise ConfigError(instead)
    _resolve_references(model, document, (), locations)
    try:
        return model.model_validate(document.data, context=AS_RECORDED if as_recorded else None)
    except ValidationError as error:
        place, message = explain(model, document, error, flags or {})
        # A bad value that came by a flag is a fault of the command line, not of any config.
        kind = UsageError if is_setting(place) else ConfigError
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
            for part in models_in(info.annotation):
                if issubclass(part, Config):
                    _resolve_references(part, document, (*path, name), locations)


def _put_in(
    document: Document, path: KeyPath, kind: str, target: type[Config], name: str, locations: Locations
) -> None:
    """Replace the name of a config at `path` by its content."""
    try:
        file = locations.config_file(kind, name)
    except ConfigError as error:
        raise ConfigError(f"{document.place(path)}: {dotted(path)}: {error}") from error
    other = _read(target, file)
    if instead := _other_kind(target, other):
        raise ConfigError(f"{document.place(path)}: {dotted(path)}: {instead}")
    document.graft(path, other)
