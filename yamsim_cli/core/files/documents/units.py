"""Quantities with a unit and plausible bounds: a value far out of bounds was probably given in another unit.

The configs of recorded datasets may have values beyond the bounds, see `SKIP_BOUNDS_CONTEXT`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import AfterValidator, FiniteFloat, GetCoreSchemaHandler, GetJsonSchemaHandler, ValidationInfo
from pydantic_core import CoreSchema, core_schema

from .config_base import require_ordered

# Pydantic context in which bounds are not checked: a recorded dataset's config stays valid after a change of bounds.
SKIP_BOUNDS_CONTEXT: Mapping[str, bool] = {"recorded": True}

# Correct unit -> mistaken unit -> size of the mistaken unit in the correct unit.
_MISTAKEN_UNITS: Mapping[str, Mapping[str, float]] = {
    "m": {"mm": 1e-3, "cm": 1e-2},
    "mm": {"m": 1e3},
    "m/s": {"mm/s": 1e-3},
    "s": {"ms": 1e-3},
    "g": {"kg": 1e3},
    "kg m2": {"g mm2": 1e-9, "kg mm2": 1e-6},
    "rad": {"degrees": math.pi / 180},
    "degrees": {"radians": 180 / math.pi},
    "of 1": {"values of 255": 1 / 255},
}


@dataclass(frozen=True)
class QuantityBounds:
    """Marks a number as a quantity in `unit` between two bounds; with `or_zero`, the value 0 is also valid."""

    unit: str
    low: float
    high: float
    or_zero: bool = False

    def check(self, value: float, info: ValidationInfo | None = None) -> float:
        """Return the value; raise ValueError if it is out of bounds, with a guess of its unit."""
        if self._is_within_bounds(value) or is_recorded_config(info):
            return value
        raise ValueError(f"must lie in {self.low:.6g}..{self.high:.6g} {self.unit}{self._guess_meant_unit(value)}")

    def _is_within_bounds(self, value: float) -> bool:
        return self.low <= value <= self.high or (self.or_zero and value == 0)

    def _guess_meant_unit(self, value: float) -> str:
        others = {name: value * factor for name, factor in _MISTAKEN_UNITS.get(self.unit, {}).items()}
        fitting = [
            f"is it in {name}? Then give {meant:.4g}" for name, meant in others.items() if self._is_within_bounds(meant)
        ]
        return "".join(f"; {text}" for text in fitting)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_after_validator_function(self.check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        bounds = {"minimum": min(0.0, self.low) if self.or_zero else self.low, "maximum": self.high}
        return handler(schema) | bounds | {"description": f"in {self.unit}"}


def is_recorded_config(info: ValidationInfo | None) -> bool:
    """Return whether pydantic validates the config of a recorded dataset."""
    return info is not None and info.context == SKIP_BOUNDS_CONTEXT


def _refuse_radians(value: tuple[float, float], info: ValidationInfo) -> tuple[float, float]:
    """Refuse a range whose ends are an eighth, a quarter, a half or a full turn in radians."""
    turns = [2 * math.pi / k for k in (1, 2, 4, 8)]
    ends = [abs(end) for end in value if end]
    if not ends or is_recorded_config(info) or not all(min(abs(end - turn) for turn in turns) < 0.004 for end in ends):
        return value
    low, high = (round(math.degrees(end)) for end in value)
    raise ValueError(
        f"{value[0]:g}..{value[1]:g} degrees is a small range; is it in radians? Then give [{low}, {high}]"
    )


Place = Annotated[FiniteFloat, QuantityBounds("m", -10, 10)]  # in `world`
Size = Annotated[FiniteFloat, QuantityBounds("m", 1e-3, 10)]  # half-size of a table
Offset = Annotated[FiniteFloat, QuantityBounds("m", -1, 1)]  # coordinate in the frame of an object
Distance = Annotated[FiniteFloat, QuantityBounds("m", 0, 1)]  # gap or relative height
Share = Annotated[FiniteFloat, QuantityBounds("of 1", 0, 1)]  # fraction of a whole
Heading = Annotated[FiniteFloat, QuantityBounds("degrees", -360, 360)]
FieldOfView = Annotated[
    FiniteFloat, QuantityBounds("degrees", 4, 179)
]  # vertical field of view; every value in radians is below the lower bound
JointAngle = Annotated[FiniteFloat, QuantityBounds("rad", -2 * math.pi, 2 * math.pi)]
WorkspaceCoordinate = Annotated[
    FiniteFloat, QuantityBounds("m", -2.5, 2.5)
]  # x or y of a place that an arm can reach, in `world` or relative to the arm

PlacePoint = tuple[Place, Place, Place]
OffsetPoint = tuple[Offset, Offset, Offset]
WorkspaceRange = Annotated[tuple[WorkspaceCoordinate, WorkspaceCoordinate], AfterValidator(require_ordered)]
HeadingRange = Annotated[tuple[Heading, Heading], AfterValidator(require_ordered), AfterValidator(_refuse_radians)]
