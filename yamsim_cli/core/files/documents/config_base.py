from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat

from .yaml_document import Document, load_yaml


class Config(BaseModel):
    """Base of all configs: immutable, with finite numbers and without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True, allow_inf_nan=False)

    @classmethod
    def read_document(cls, path: Path) -> Document:
        """Return a file's content under the keys of this config. Raises as `load_yaml`."""
        return load_yaml(path)

    @classmethod
    def config_paths_in_file(cls, path: Path) -> tuple[Path, ...]:
        """Return the paths to pass to `read_document`, one for each config in a file."""
        return (path,)


@dataclass(frozen=True)
class ConfigReference:
    """Marks a field that contains a config of kind `kind`. A file may have its name instead, as in `rig: single`."""

    kind: str


class ConflictError(ValueError):
    """A contradiction between several values. The message points to the value that a flag set, else to the first value.

    `paths` are relative to the model that raises; the most likely mistake comes first.
    """

    def __init__(self, message: str, *paths: tuple[str | int, ...]) -> None:
        super().__init__(message)
        self.paths = paths


def require_ordered(value: tuple[float, float]) -> tuple[float, float]:
    """Return the range. Raises ValueError if its ends are not in order."""
    if value[0] > value[1]:
        raise ValueError(f"a range is [low, high], so {value[0]} must not be above {value[1]}")
    return value


def _unit_fractions(value: tuple[float, ...]) -> tuple[float, ...]:
    if not all(0.0 <= part <= 1.0 for part in value):
        raise ValueError("each part must lie in 0..1")
    return value


def _require_rotation(value: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    if math.hypot(*value) < 1e-9:
        raise ValueError("a zero quaternion is not a rotation")
    return value


Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Quaternion = Annotated[tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat], AfterValidator(_require_rotation)]
Range = Annotated[tuple[FiniteFloat, FiniteFloat], AfterValidator(require_ordered)]
Rgba = Annotated[tuple[float, float, float, float], AfterValidator(_unit_fractions)]
Rgb = Annotated[tuple[float, float, float], AfterValidator(_unit_fractions)]
Positive = Annotated[FiniteFloat, Field(gt=0)]
NonNegative = Annotated[FiniteFloat, Field(ge=0)]
# Names of cameras, objects and tasks become parts of paths, so the pattern excludes dots and slashes.
NAME_PATTERN = r"^[A-Za-z][A-Za-z0-9_]*$"
Name = Annotated[str, Field(pattern=NAME_PATTERN)]
