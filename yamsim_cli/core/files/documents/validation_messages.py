from __future__ import annotations

import re
import types
from collections.abc import Iterable, Iterator, Mapping
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from ...errors import count_noun, suggest_similar
from .config_base import Config, ConflictError, require_ordered
from .yaml_document import Document, KeyPath, is_setting

UNION_BRANCH_MARK = "<"  # first character of names that pydantic reports for branches of unions, which are no keys

_DECIMAL_COMMA = re.compile(r"[-+]?[0-9]+,[0-9]+")


def explain_validation_error(
    model: type[Config], document: Document, error: ValidationError, flags: Mapping[KeyPath, str]
) -> tuple[str, str]:
    """Return the place ("file:line" or flag) of the first error, and one line about it with the number of others.

    `flags` has the flag that set the value at each key path.
    """
    found = error.errors(include_url=False)
    # Pydantic also reports a list with an invalid item as too short.
    inside = {detail["loc"][:depth] for detail in found for depth in range(len(detail["loc"]))}
    # Pydantic reports a mistyped key as unknown and as missing. The unknown key comes first.
    details = sorted(
        (detail for detail in found if detail["loc"] not in inside), key=lambda detail: detail["type"] == "missing"
    )
    first = details[0]
    path: KeyPath = tuple(key for key in first["loc"] if not _is_tag(document.data, first["loc"], key))
    if first["type"] == "missing" and isinstance(path[-1], int):
        path = path[:-1]
    more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
    fault = first.get("ctx", {}).get("error")
    if isinstance(fault, ConflictError):
        path, place = _offending_value(document, [(*path, *part) for part in fault.paths], flags)
    else:
        place = document.place_of(path)
    key = "" if is_setting(place) else f"{format_key_path(path) or 'config'}: "
    return place, f"{key}{_explain_detail(model, path, first)}{more}"


def explain_conflict(document: Document, error: ConflictError, flags: Mapping[KeyPath, str]) -> tuple[str, str]:
    """Return the place and a message of a conflict raised outside of pydantic's validation."""
    path, place = _offending_value(document, list(error.paths), flags)
    return place, str(error) if is_setting(place) else f"{format_key_path(path) or 'config'}: {error}"


def detect_other_kind(kinds: Mapping[str, type[Config]], wanted: str, data: Mapping[str, Any]) -> str | None:
    """Return the other kind of config whose keys a file has; None if the keys fit the wanted kind, or no kind."""
    keys = set(data) - {"name"}
    # Kinds share some keys. The keys fit if at least half of them, and one required key, belong to the wanted kind.
    fields = kinds[wanted].model_fields
    required = {name for name, info in fields.items() if info.is_required()} - {"name"}
    if 2 * len(keys & set(fields)) >= len(keys) and (keys & required or not required):
        return None
    return next(
        (kind for kind, model in kinds.items() if kind != wanted and keys and keys <= set(model.model_fields)), None
    )


def models_in(annotation: Any) -> list[type[BaseModel]]:
    """Return the pydantic models in a field's annotation, also inside tuples, lists and unions."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) in (Annotated, Union, types.UnionType, tuple, list):
        return [model for part in get_args(annotation) for model in models_in(part)]
    return []


def mapping_value_type(annotation: Any) -> Any:
    """Return the annotation of a mapping's values; None for any other annotation."""
    return get_args(annotation)[1] if get_origin(annotation) in (dict, Mapping) else None


def format_key_path(path: KeyPath) -> str:
    """Return a key path as text, such as `arms[0].board`."""
    text = ""
    for key in path:
        text += f"[{key}]" if isinstance(key, int) else f".{key}" if text else str(key)
    return text


def _offending_value(document: Document, paths: list[KeyPath], flags: Mapping[KeyPath, str]) -> tuple[KeyPath, str]:
    """Return key path and place of the first value that a flag set, else of the first value."""
    for path in paths:
        for whole in (path, path[:-1]) if path and isinstance(path[-1], int) else (path,):
            if whole in flags:
                return whole, flags[whole]
    return paths[0], document.place_of(paths[0])


def _explain_detail(model: type[Config], path: KeyPath, detail: ErrorDetails) -> str:
    value = detail["input"]
    if isinstance(detail.get("ctx", {}).get("error"), ConflictError):
        return detail["msg"].removeprefix("Value error, ")
    match detail["type"]:
        case "extra_forbidden":
            return f"unknown key; {suggest_similar(str(path[-1]), _keys_at(model, path[:-1]))}"
        case "missing" if isinstance(detail["loc"][-1], int):
            return f"has {count_noun(detail['loc'][-1], 'value')}; give {_describe_list_shape(model, path)}"
        case "missing":
            return "missing; add it"
        case "tuple_type":
            return f"{value!r} is not valid: give {_describe_list_shape(model, path)}"
        case "too_long" | "too_short" if isinstance(value, list) and (shape := _describe_list_shape(model, path)):
            return f"has {len(value)} values; give {shape}{_decimal_comma_hint(value, detail)}"
        case "float_parsing" | "int_parsing" if isinstance(value, str) and _DECIMAL_COMMA.fullmatch(value):
            return f"{value!r} is not valid: a number has a decimal point; write {value.replace(',', '.')}"
    message = detail["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
    return message if isinstance(value, dict) else f"{value!r} is not valid: {message}"


def _decimal_comma_hint(values: list[Any], detail: ErrorDetails) -> str:
    wanted = detail.get("ctx", {}).get("max_length")
    whole = all(isinstance(value, int) for value in values[1::2])
    return "; a number has a decimal point, not a comma" if wanted and len(values) == 2 * wanted and whole else ""


def _describe_list_shape(model: type[Config], path: KeyPath) -> str:
    for annotation, metadata in _annotations_at(model, path):
        parts = get_args(annotation) if get_origin(annotation) is tuple else ()
        if not parts or Ellipsis in parts:
            continue
        if any(getattr(mark, "func", None) is require_ordered for mark in metadata):
            return "[low, high]"
        return "[x, y, z]" if len(parts) == 3 and float in map(_strip_annotated, parts) else f"a list of {len(parts)}"
    return "a list"


def _annotations_at(model: type[Config], path: KeyPath) -> Iterable[tuple[Any, tuple[Any, ...]]]:
    if not path or isinstance(path[-1], int):
        return
    for candidate in _models_at(model, path[:-1]):
        if (field := candidate.model_fields.get(path[-1])) is None:
            continue
        options = get_args(field.annotation) if _is_union(field.annotation) else (field.annotation,)
        for option in options:
            marks = tuple(field.metadata)
            if get_origin(option) is Annotated:
                option, *more = get_args(option)
                marks += tuple(more)
            yield option, marks


def _is_union(annotation: Any) -> bool:
    return get_origin(annotation) in (Union, types.UnionType)


def _strip_annotated(annotation: Any) -> Any:
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    return annotation


def _is_tag(data: Any, loc: tuple[int | str, ...], key: int | str) -> bool:
    """Return whether a part of pydantic's location names a union's branch, and is no key of the document."""
    if isinstance(key, str) and key.startswith(UNION_BRANCH_MARK):
        return True
    here = data
    for part in loc:
        if isinstance(part, str) and part.startswith(UNION_BRANCH_MARK):
            continue
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
    return sorted({name for candidate in _models_at(model, path) for name in candidate.model_fields})


def _models_at(model: type[BaseModel], path: KeyPath) -> list[type[BaseModel]]:
    annotations: list[Any] = [model]
    for key in path:
        if isinstance(key, str):
            annotations = [inner for one in annotations for inner in _nested_annotations(one, key)]
    return [model for one in annotations for model in models_in(one)]


def _nested_annotations(annotation: Any, key: str) -> Iterator[Any]:
    if (values := mapping_value_type(annotation)) is not None:
        yield values
    for model in models_in(annotation):
        if key in model.model_fields:
            yield model.model_fields[key].annotation
