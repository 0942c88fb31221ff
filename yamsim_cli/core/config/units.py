"""Quantities with a unit, within what can be meant: a value far outside was probably given in another unit.

The bounds are wide: they refuse what nobody means, not what few do. What was recorded is not held to them, see
`AS_RECORDED`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import AfterValidator, FiniteFloat, GetCoreSchemaHandler, GetJsonSchemaHandler, ValidationInfo
from pydantic_core import CoreSchema, core_schema

from .base import ordered

# The validation context of a dataset's own config: what was valid when it was recorded stays so.
AS_RECORDED: Mapping[str, bool] = {"as_recorded": True}

# Unit -> the units that people give in its place, and what one of them is in it.
_MISTAKEN: Mapping[str, Mapping[str, float]] = {
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
class Within:
    """Marks a number as a quantity in `unit` that lies between two bounds, or is 0 where `or_zero`."""

    unit: str
    low: float
    high: float
    or_zero: bool = False

    def check(self, value: float, info: ValidationInfo | None = None) -> float:
        """The value itself.

        Raises:
            ValueError: it lies outside; the text names the unit that was probably meant.
        """
        if self._holds(value) or as_recorded(info):
            return value
        raise ValueError(f"must lie in {self.low:.6g}..{self.high:.6g} {self.unit}{self._meant(value)}")

    def _holds(self, value: float) -> bool:
        return self.low <= value <= self.high or (self.or_zero and value == 0)

    def _meant(self, value: float) -> str:
        others = {name: value * factor for name, factor in _MISTAKEN.get(self.unit, {}).items()}
        fitting = [f"is it in {name}? Then give {meant:.4g}" for name, meant in others.items() if self._holds(meant)]
        return "".join(f"; {text}" for text in fitting)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_after_validator_function(self.check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        bounds = {"minimum": min(0.0, self.low) if self.or_zero else self.low, "maximum": self.high}
        return handler(schema) | bounds | {"description": f"in {self.unit}"}


def as_recorded(info: ValidationInfo | None) -> bool:
    """Whether a dataset's own config is being checked, which has been used as it is."""
    return info is not None and info.context == AS_RECORDED


def _more_than_a_hair(value: tuple[float, float], info: ValidationInfo) -> tuple[float, float]:
    """Refuse an eighth, a quarter, half or the whole of a turn in radians: as degrees these are hardly a turn."""
    turns = [2 * math.pi / k for k in (1, 2, 4, 8)]
    ends = [abs(end) for end in value if end]
    if not ends or as_recorded(info) or not all(min(abs(end - turn) for turn in turns) < 0.004 for end in ends):
        return value
    low, high = (round(math.degrees(end)) for end in value)
    raise ValueError(
        f"{value[0]:g}..{value[1]:g} degrees is hardly a turn; is it in radians? Then give [{low}, {high}]"
    )


# Where something is in a station, m, and how large it is; and a place in the frame of a thing on a table.
Place = Annotated[FiniteFloat, Within("m", -10, 10)]
Size = Annotated[FiniteFloat, Within("m", 1e-3, 10)]
Offset = Annotated[FiniteFloat, Within("m", -1, 1)]
# A gap, or a height over something, m.
Distance = Annotated[FiniteFloat, Within("m", 0, 1)]
Heading = Annotated[FiniteFloat, Within("degrees", -360, 360)]
# From a picture's top to its bottom. Whatever is given in radians lies below.
FieldOfView = Annotated[FiniteFloat, Within("degrees", 4, 179)]
# Of a joint: no arm's turns farther from its zero than once around.
JointAngle = Annotated[FiniteFloat, Within("rad", -2 * math.pi, 2 * math.pi)]

# Where things stand that an arm is to reach, in its place's frame, m.
_Reach = Annotated[FiniteFloat, Within("m", -2.5, 2.5)]

PlacePoint = tuple[Place, Place, Place]
OffsetPoint = tuple[Offset, Offset, Offset]
ReachRange = Annotated[tuple[_Reach, _Reach], AfterValidator(ordered)]
HeadingRange = Annotated[tuple[Heading, Heading], AfterValidator(ordered), AfterValidator(_more_than_a_hair)]
