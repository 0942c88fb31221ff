"""The base of all config models, and the types that they share."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat

from .document import Document, load_yaml


class Config(BaseModel):
    """Base of all configs: immutable, numbers finite, and an unknown key is an error rather than a silent default."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True, allow_inf_nan=False)

    @classmethod
    def read(cls, path: Path) -> Document:
        """A file's content under this config's own keys. Raises as `load_yaml`."""
        return load_yaml(path)

    @classmethod
    def within(cls, path: Path) -> tuple[Path, ...]:
        """The path that `read` takes for each config in a file: the file's own, where a file holds one config."""
        return (path,)


@dataclass(frozen=True)
class Reference:
    """Marks a field that may name a config of another kind instead of spelling it out: `rig: single`.

    Attributes:
        kind: the kind of config among which the name is looked up.
    """

    kind: str


class ConflictError(ValueError):
    """Several values that do not go together. The message names the one that a flag gave, or else the first.

    Attributes:
        paths: key paths of the values, from the model that finds the fault; the likeliest culprit first.
    """

    def __init__(self, message: str, *paths: tuple[str | int, ...]) -> None:
        super().__init__(message)
        self.paths = paths


def ordered(value: tuple[float, float]) -> tuple[float, float]:
    """The range itself. Raises ValueError if its ends are not in order."""
    if value[0] > value[1]:
        raise ValueError(f"a range is [low, high], so {value[0]} must not be above {value[1]}")
    return value


def _unit_fractions(value: tuple[float, ...]) -> tuple[float, ...]:
    if not all(0.0 <= part <= 1.0 for part in value):
        raise ValueError("each part must lie in 0..1")
    return value


def _rotation(value: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    if math.hypot(*value) < 1e-9:
        raise ValueError("a zero quaternion is no rotation")
    return value


Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Quaternion = Annotated[tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat], AfterValidator(_rotation)]
Range = Annotated[tuple[FiniteFloat, FiniteFloat], AfterValidator(ordered)]
Rgba = Annotated[tuple[float, float, float, float], AfterValidator(_unit_fractions)]
Rgb = Annotated[tuple[float, float, float], AfterValidator(_unit_fractions)]
Positive = Annotated[FiniteFloat, Field(gt=0)]
NonNegative = Annotated[FiniteFloat, Field(ge=0)]
# Pattern of names that become parts of paths: of cameras, things, tasks. It admits no dot and no slash.
NAME_PATTERN = r"^[A-Za-z][A-Za-z0-9_]*$"
Name = Annotated[str, Field(pattern=NAME_PATTERN)]
