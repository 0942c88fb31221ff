"""Cloth: a rectangle of fabric as a grid of points that stretches and bends."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, FiniteFloat, ValidationError

from ...files.documents.config_base import Config, NonNegative, Rgb
from ...files.documents.units import QuantityBounds
from .generated import GENERATED_SET

_SideLengthMm = Annotated[FiniteFloat, QuantityBounds("mm", 50, 1500)]
_PointsPerSide = Annotated[int, Field(ge=5, le=25)]

_POISSON = 0.2  # Poisson's ratio


class Cloth(Config):
    """A rectangle of fabric in the xy plane of its own frame, its middle at the origin.

    Attributes:
        size_mm: size along x and along y.
        grid: numbers of points along x and along y.
        mass_g: total mass.
        thickness_mm: distance between two layers in contact.
        stretching_n_m: force per width that doubles the length, N/m.
        bending_n_m: moment per width that bends the fabric to a radius of 1 m, N m.
        damping_s: time constant of stretching and bending.
        friction: sliding friction against the table, hands and itself.
        held: "points": a hand holds all points between its pads; "layers": also one point of each layer between them.
        release: "clear": fingers that release the cloth have no contacts with it until they close again or have left
            it; "touching": they keep their contacts. Closed fingers pass through the sheet, so with "touching" the
            cloth can hang on them when they open.
        solver: MuJoCo's solver in scenes with the cloth: `cg` takes half the time for large grids (21 x 21).
        checks: number of squares along x in a pattern of the second colour; 0 for none.
        colours: colours (RGB) of the fabric and of the checks.
    """

    size_mm: tuple[_SideLengthMm, _SideLengthMm]
    grid: tuple[_PointsPerSide, _PointsPerSide]
    mass_g: Annotated[FiniteFloat, QuantityBounds("g", 0.5, 2000)]
    thickness_mm: Annotated[FiniteFloat, QuantityBounds("mm", 2, 20)] = 5.0
    stretching_n_m: Annotated[FiniteFloat, QuantityBounds("N/m", 10, 1e4)] = 400.0
    bending_n_m: Annotated[FiniteFloat, QuantityBounds("N m", 1e-7, 1e-2)] = 2e-5
    damping_s: Annotated[FiniteFloat, QuantityBounds("s", 0, 1)] = 0.01
    friction: NonNegative = 0.6
    held: Literal["points", "layers"] = "points"
    release: Literal["touching", "clear"] = "touching"
    solver: Literal["newton", "cg"] = "newton"
    checks: Annotated[int, Field(ge=0, le=50)] = 0
    colours: tuple[Rgb, Rgb] = ((0.9, 0.9, 0.88), (0.7, 0.25, 0.2))

    @property
    def size(self) -> tuple[float, float]:
        """Size along x and along y, m."""
        return self.size_mm[0] / 1000, self.size_mm[1] / 1000

    @property
    def mass(self) -> float:
        """Total mass, kg."""
        return self.mass_g / 1000

    @property
    def half_thickness(self) -> float:
        """Half the thickness, m: the height of points above the surface on which they lie."""
        return self.thickness_mm / 2000

    @property
    def max_point_spacing(self) -> float:
        """The larger of the distances between neighbours along x and along y, m."""
        return max(side / (count - 1) for side, count in zip(self.size, self.grid, strict=True))

    @property
    def elastic_constants(self) -> tuple[float, float, float]:
        """Young's modulus (Pa), Poisson's ratio and thickness (m) of the plate with this stretching and bending."""
        thickness = math.sqrt(12 * (1 - _POISSON**2) * self.bending_n_m / self.stretching_n_m)
        return self.stretching_n_m / thickness, _POISSON, thickness


def object_keys_from_cloth(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of an object's config that follow from its `cloth`, as of a flat box; empty if not valid."""
    if not isinstance(data.get("cloth"), dict):
        return {}
    try:
        cloth = Cloth.model_validate(data["cloth"])
    except ValidationError:
        return {}  # the validation of the whole config reports the error with its line
    (x, y), mass, radius = cloth.size, cloth.mass, cloth.half_thickness
    moments = (mass * y**2 / 12, mass * x**2 / 12, mass * (x**2 + y**2) / 12)
    return {
        "mesh": {
            "set": GENERATED_SET,
            "file": f"{data.get('name')}.stl",
            "origin": [0.0, 0.0, 0.0],
            "rgba": [1.0, 1.0, 1.0, 1.0],
            "specular": 0.0,
            "shininess": 0.0,
        },
        "inertia": {
            "mass_g": cloth.mass_g,
            "diagonal": [float(f"{moment:.4g}") for moment in moments],
            "quat": [1.0, 0.0, 0.0, 0.0],
        },
        "contact": {"friction": [cloth.friction, 0.005, 0.0001]},
        "collision": [{"type": "box", "centre": [0.0, 0.0, 0.0], "half_size": [x / 2, y / 2, radius]}],
        "rest_height": radius,
    }
