"""Things that are made from their sizes, in other sizes."""

from __future__ import annotations

from typing import Any

from pydantic import TypeAdapter, ValidationError

from .made import made_object
from .shapes import Shape
from .thing import ObjectConfig

_SHAPE: TypeAdapter[Shape] = TypeAdapter(Shape)

# What of a shape is a length or a weight, by how its key ends: it grows with so high a power of the factor.
_POWERS = {"_mm": 1, "_g": 3}


def scaled(item: ObjectConfig, factor: float) -> ObjectConfig:
    """The same thing with all lengths times a factor, and made anew: its weight and its grasps follow.

    Raises:
        ValueError: it is not made from sizes alone, or cannot be made in these.
    """
    if factor == 1.0:
        return item
    if item.shape is None:
        raise ValueError(f"the {item.name} has no `shape`, and only what is made from its sizes has others")
    given = item.model_dump(mode="json")
    if own := sorted(_differs(given, _completed(item.name, item.shape, given))):
        raise ValueError(f"the {item.name} has `{own[0]}` of its own beside its `shape`, which does not grow with it")
    data = item.shape.model_dump(mode="json", exclude_none=True)
    try:
        shape = _SHAPE.validate_python({key: _grown(key, value, factor) for key, value in data.items()})
        return _completed(item.name, shape, given)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        reason = first["msg"].removeprefix("Value error, ")
        raise ValueError(f"the {item.name} cannot be made {factor:g} times as large: {where}: {reason}") from error


def _completed(name: str, shape: Shape, given: dict[str, Any]) -> ObjectConfig:
    made = made_object(name, shape)
    kept = {key: value for key, value in given.items() if key not in made and key not in ("grasp", "support")}
    return ObjectConfig.model_validate({**kept, "shape": shape.model_dump(mode="json", exclude_none=True), **made})


def _differs(given: dict[str, Any], made: ObjectConfig) -> set[str]:
    plain = made.model_dump(mode="json")
    return {key for key in given if given[key] != plain.get(key)}


def _grown(key: str, value: Any, factor: float) -> Any:
    power = next((power for end, power in _POWERS.items() if key.endswith(end)), None)
    if power is None:
        return value
    return [one * factor**power for one in value] if isinstance(value, list) else value * factor**power
